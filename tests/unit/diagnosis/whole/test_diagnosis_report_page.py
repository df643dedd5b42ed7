"""The report in a real browser: the verdict stands on the first screen, nothing overflows, nobody else is asked.

Set LONGREACH_SCREENSHOTS to a folder to keep the picture (the README's is made this way).
"""

import os
import re
import shutil
from pathlib import Path

import pytest
from foreign_plant import Fault, write
from typer.testing import CliRunner

from longreach.cli import app

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
FAULTS = Fault(deadband=(0.0, 0.03), sag_rad_nm=2e-6)
KINDS = ("repeat", "repeat", "repeat", "repeat", "steps", "workcycle")
SCREEN = {"width": 1280, "height": 800}
PHONE = {"width": 390, "height": 844}
OVERFLOWS = """() => [...document.querySelectorAll('svg text')].filter(text => {
  const outer = text.ownerSVGElement.getBoundingClientRect(), inner = text.getBoundingClientRect();
  return inner.width > 0 && (inner.left < outer.left - 1 || inner.right > outer.right + 1);
}).map(text => text.textContent)"""
WIDER_THAN_ITS_BOX = """() => [...document.querySelectorAll('svg g')].flatMap(g => {
  const box = g.querySelector('rect');
  if (!box) return [];
  const most = box.getBoundingClientRect().width;
  return [...g.querySelectorAll('text')].filter(t => t.getBoundingClientRect().width > most).map(t => t.textContent);
})"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a boom whose valve has a dead band and whose joint sags."""
    folder = tmp_path_factory.mktemp("report")
    made = write(folder / "boom", FAULTS, seconds=10.0, kinds=KINDS, tracker_m=2e-4)
    page = folder / "report.html"
    said = CliRunner().invoke(app, ["diagnose", str(made), "--html", str(page)])
    assert said.exit_code == 0, said.output
    return page


@pytest.fixture
def opened(report: Path):
    """The report on a screen, with what it asked for and what went wrong in it."""
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=["--no-sandbox"])
        page = browser.new_page(viewport=SCREEN)
        asked: list[str] = []
        page.on("request", lambda one: asked.append(one.url))
        page.on("pageerror", lambda one: asked.append(str(one)))
        page.goto(report.as_uri())
        yield page
        assert asked == [report.as_uri()]
        browser.close()


def test_the_verdict_is_read_on_the_first_screen(opened) -> None:
    headline = opened.locator("h1, h2").first
    assert re.fullmatch(
        r"The model misses the tool by [\d.]+ mm\. With the .* it misses by [\d.]+ mm\.", headline.inner_text()
    )
    for said in (
        "probability",
        "largest cause",
        "What costs how much",
        "nominal model misses",
        "valve deadband",
        "gravity sag",
    ):
        box = opened.get_by_text(said).first.bounding_box()
        assert box is not None, said
        assert box["y"] + box["height"] < SCREEN["height"], said
    kept = os.environ.get("LONGREACH_SCREENSHOTS")
    if kept:
        Path(kept).mkdir(parents=True, exist_ok=True)
        opened.screenshot(path=Path(kept) / "report.png")


def test_no_label_leaves_its_picture(opened) -> None:
    assert opened.evaluate(OVERFLOWS) == []
    assert opened.evaluate(WIDER_THAN_ITS_BOX) == []


def test_it_fits_a_phone(opened) -> None:
    opened.set_viewport_size(PHONE)
    width = opened.evaluate("() => document.documentElement.scrollWidth")
    assert width <= PHONE["width"]


def test_what_is_folded_away_opens_without_a_script(opened) -> None:
    folded = opened.locator("details:not([open]) > summary").first
    name = folded.inner_text()
    folded.click()
    assert opened.locator("details[open] > summary", has_text=name).count() == 1
