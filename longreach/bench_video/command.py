"""`longreach bench video`."""

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from longreach.bench_video.viewing import FLAGS, latencies, opened, watch
from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts

console = Console(width=160)
SETTLE_S = 3.0


def video(
    seconds: Annotated[float, typer.Option(help="for each number of viewers, and for the latency")] = 30.0,
    viewers: Annotated[str, typer.Option(help="numbers of viewers, one after the other")] = "0,1,2,4",
    rate_hz: Annotated[float, typer.Option(help="the simulated camera's pairs a second")] = 20.0,
    seed: Annotated[int, typer.Option(help="which machine is drawn")] = 1,
    folder: Annotated[Path, typer.Option(help="where figures and logs are kept")] = Path("runs/bench-video"),
    chromium: Annotated[str, typer.Option(help="the browser")] = "/usr/bin/chromium",
) -> None:
    """Frames drawn a second, exposure to pixel, and vision's rate with several viewers; live simulated stream."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        console.print("playwright is not installed: pip install 'longreach[test]'")
        raise typer.Exit(2) from None
    counts = [int(text) for text in viewers.split(",")]
    stack = Stack(
        StackPorts.free(),
        seed=seed,
        runs=folder / "runs",
        log_folder=folder / "logs",
        camera_rate_hz=rate_hz,
        sim_options=("--camera-time-code",),
    )
    found: list[dict[str, object]] = []
    with stack, JobClient(stack.url) as client, sync_playwright() as driver:
        client.wait_ready(180.0)
        browser = driver.chromium.launch(executable_path=chromium, headless=True, args=list(FLAGS))
        pages: list[object] = []
        for count in counts:
            pages += [opened(browser, stack.url) for _ in range(count - len(pages))]
            time.sleep(SETTLE_S)
            one = watch(stack.url, pages, seconds)
            found.append(asdict(one))
            rates = " ".join(f"{rate:.1f}" for rate in one.viewer_hz)
            console.print(f"{count} viewers: vision {one.vision_hz:.1f} pairs/s; drawn a second: {rates or '-'}")
        for page in pages[1:]:
            page.context.close()  # pyright: ignore[reportAttributeAccessIssue] # playwright is an extra
        page = pages[0] if pages else opened(browser, stack.url)
        ages = latencies(page, seconds, lambda: time.time_ns() - time.monotonic_ns())
        browser.close()
    _tell(ages)
    report = {"viewers": found, "latency_ms": [round(age, 1) for age in ages]}
    (folder / "video.json").write_text(json.dumps(report, indent=1), encoding="utf-8")


def _tell(ages_ms: list[float]) -> None:
    if not ages_ms:
        console.print("no time code was read back: no latency")
        return
    p50, p99 = np.percentile(ages_ms, [50, 99])
    console.print(f"exposure to composed frame: p50 {p50:.0f} ms, p99 {p99:.0f} ms, N {len(ages_ms)}")
