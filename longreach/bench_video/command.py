"""`longreach bench video`."""

import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from longreach.bench_video.viewing import Watched, latencies, opened, watch, watch_elsewhere
from longreach.fleet_client import JobClient
from longreach.headless import headless
from longreach.processes import Stack, StackPorts
from recording.clock import mono_ns

console = Console(width=160)
SETTLE_S = 3.0


def video(
    seconds: Annotated[float, typer.Option(help="for each number of viewers, and for the latency")] = 30.0,
    viewers: Annotated[str, typer.Option(help="numbers of browsers here, growing")] = "0,1,2",
    elsewhere: Annotated[str, typer.Option(help="numbers of viewers that draw elsewhere: sockets")] = "1,4",
    rate_hz: Annotated[float, typer.Option(help="the simulated camera's pairs a second")] = 20.0,
    seed: Annotated[int, typer.Option(help="which machine is drawn")] = 1,
    folder: Annotated[Path, typer.Option(help="where figures and logs are kept")] = Path("runs/bench-video"),
    chromium: Annotated[str, typer.Option(help="the browser")] = "/usr/bin/chromium",
) -> None:
    """Frames drawn a second, exposure to pixel, and vision's rate with several viewers; live simulated stream."""
    stack = Stack(
        StackPorts.free(),
        seed=seed,
        runs=folder / "runs",
        log_folder=folder / "logs",
        camera_rate_hz=rate_hz,
        sim_options=("--camera-time-code",),
    )
    found: list[Watched] = []
    with stack, JobClient(stack.url) as client, headless(chromium) as browser:
        client.wait_ready(180.0)
        for one in _rates(stack, browser, _numbers(viewers), _numbers(elsewhere), seconds):
            found.append(one)
            _save(folder, found, [])
        ages = latencies(opened(browser, stack.url), seconds, lambda: time.time_ns() - mono_ns())
    _tell(ages)
    _save(folder, found, ages)


def _numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",") if part]


def _rates(stack: Stack, browser: Any, here: list[int], elsewhere: list[int], seconds: float) -> Iterator[Watched]:
    """Browsers first, more and more of them; then, with none, the sockets."""
    pages: list[Any] = []
    for count in here:
        pages += [opened(browser, stack.url) for _ in range(count - len(pages))]
        time.sleep(SETTLE_S)
        yield _told(watch(stack, pages, seconds))
    for page in pages:
        page.context.close()
    for count in elsewhere:
        time.sleep(SETTLE_S)
        yield _told(watch_elsewhere(stack, count, seconds))


def _told(one: Watched) -> Watched:
    rates = " ".join(f"{rate:.1f}" for rate in one.viewer_hz)
    vision = f"vision {one.vision_hz:.1f} pairs/s, server {one.server_cpu_pct:.0f} % of a core"
    console.print(f"{one.viewers} viewers {one.where}: {vision}; frames a second: {rates or '-'}", highlight=False)
    return one


def _save(folder: Path, found: list[Watched], ages_ms: list[float]) -> None:
    report = {"viewers": [asdict(one) for one in found], "latency_ms": [round(age, 1) for age in ages_ms]}
    (folder / "video.json").write_text(json.dumps(report, indent=1), encoding="utf-8")


def _tell(ages_ms: list[float]) -> None:
    if not ages_ms:
        console.print("no time code was read back: no latency")
        return
    p50, p99 = np.percentile(ages_ms, [50, 99])
    console.print(f"exposure to composed frame: p50 {p50:.0f} ms, p99 {p99:.0f} ms, N {len(ages_ms)}", highlight=False)
