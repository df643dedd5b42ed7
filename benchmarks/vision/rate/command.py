"""`longreach bench vision`."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks.vision.rate.others import plain_aruco_ms, race_on_kitti
from benchmarks.vision.rate.pairs import load_pairs
from benchmarks.vision.rate.run import RateFigures, run_rate
from server.settings import read_machine

console = Console(width=160)


def vision(
    n: Annotated[int, typer.Option(help="stereo pairs in each run")] = 3600,
    seed: Annotated[int, typer.Option(help="seed of the machine that is rendered")] = 1,
    rendered: Annotated[int, typer.Option(help="different pairs, looped to and fro")] = 300,
    data: Annotated[Path, typer.Option(help="folder with stereo/kitti_clip")] = Path("../shared/data"),
    folder: Annotated[Path, typer.Option(help="where the pairs and the result are kept")] = Path("runs/bench-vision"),
) -> None:
    """Pairs per second, latency, CPU time by stage; beside them OpenCV's plain detector and toy-vo."""
    machine = read_machine("hiab033")
    console.print("rendering pairs, unless they are there already ...")
    pairs = load_pairs(machine, folder, rendered, seed)
    found: dict[str, RateFigures] = {}
    for name, paced in (("as fast as it goes", False), ("at 60 Hz, late ones dropped", True)):
        with Progress(console=console) as progress:
            task = progress.add_task(name, total=n)
            found[name] = run_rate(machine, pairs, n, paced, lambda task=task, bar=progress: bar.advance(task))
    console.print(_rates(found))
    console.print(_stages(next(iter(found.values()))))
    median, p99 = plain_aruco_ms(pairs, machine.dictionary, min(100, rendered))
    console.print(f"ArucoDetector, sub-pixel corners, both whole eyes: {median:.1f} ms a pair, p99 {p99:.1f} (CPU)")
    _print_race(data / "stereo" / "kitti_clip")
    folder.mkdir(parents=True, exist_ok=True)
    report = {name: figures.as_json() for name, figures in found.items()} | {"plain_aruco_ms": [median, p99]}
    (folder / "vision.json").write_text(json.dumps(report, indent=1), encoding="utf-8")


def _rates(found: dict[str, RateFigures]) -> Table:
    table = Table(title="720p stereo pairs from memory, markers and odometry together", title_justify="left")
    for heading in ("run", "N", "pairs/s", "latency p50 ms", "p99", "max", "CPU ms a pair", "dropped", "poses OK %"):
        table.add_column(heading)
    for name, one in found.items():
        good = f"{100 * one.tool_ok_frac:.1f} / {100 * one.ooi_ok_frac:.1f} / {100 * one.odometry_ok_frac:.1f}"
        table.add_row(
            name,
            str(one.n_pairs),
            f"{one.pairs_per_s:.1f}",
            f"{one.latency_p50_ms:.1f}",
            f"{one.latency_p99_ms:.1f}",
            f"{one.latency_max_ms:.1f}",
            f"{one.cpu_ms_per_pair:.1f}",
            str(one.dropped),
            good,
        )
    table.caption = "poses OK: tool / OOI / odometry"
    return table


def _stages(figures: RateFigures) -> Table:
    table = Table(title="CPU time by stage, ms", title_justify="left")
    for heading in ("stage", "mean a pair", "median", "p99"):
        table.add_column(heading)
    for stage, (mean, median, p99) in figures.stages.items():
        table.add_row(stage, f"{mean:.2f}", f"{median:.2f}", f"{p99:.2f}")
    return table


def _print_race(clip: Path) -> None:
    if not clip.is_dir():
        console.print(f"no {clip}: the comparison on the KITTI clip is skipped")
        return
    races = race_on_kitti(clip)
    for race in races:
        console.print(
            f"KITTI clip, {race.name}: {race.ms_per_pair:.1f} CPU ms a pair, rotation {race.rotation_deg:.3f} deg per "
            f"frame, path {race.path_length_m:.2f} m"
        )
    if len(races) == 2:
        console.print(f"ours is {races[1].ms_per_pair / races[0].ms_per_pair:.0f} times as fast")
    else:
        console.print("toy-vo is not installed (pip install -e '.[bench]'): no comparison")
