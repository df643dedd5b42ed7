"""The headless browser of the benches that look at the panel: no graphics card, and nobody else is asked anything."""

import contextlib
from collections.abc import Iterator
from typing import Any

import typer
from rich.console import Console

FLAGS = ("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-gpu")


@contextlib.contextmanager
def headless(chromium: str) -> Iterator[Any]:
    """An open browser of that program. Raises: typer.Exit 2: playwright, which drives it, is not installed."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        Console(stderr=True).print("playwright is not installed: pip install 'longreach[test]'")
        raise typer.Exit(2) from None
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, headless=True, args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()
