"""`longreach bench unchecked`: what no pair shows by itself has to widen the answer, or be reported.

Each size is put into the drawn world of the fast bench (true lens and prints change, the machine file stays), and the
server's default positioning job runs in it. A right camera is the machine as drawn.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from benchmarks.positioning.machines.figures import CHI2_95_OF_3, drawn
from benchmarks.positioning.machines.machine_run import INSIDE_MM, MachineRun
from benchmarks.positioning.machines.saved import Order, run_machines
from benchmarks.reproduce.error_budget import SEEING
from benchmarks.reproduce.summary import Share, share

AS_DRAWN = "as drawn"
FOLDER = Path("runs/bench-unchecked")
console = Console(width=200)


def unchecked(
    preset: Annotated[str, typer.Option(help="ideal, realistic or paper")] = "realistic",
    n: Annotated[int, typer.Option(help="machines of each size")] = 100,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    only: Annotated[str, typer.Option(help="sizes by the beginning of their names; empty: all")] = "",
    workers: Annotated[int, typer.Option(help="processes")] = 1,
    folder: Annotated[Path, typer.Option(help="where every machine is saved; a second run resumes")] = FOLDER,
) -> None:
    """Focal lengths and prints that are off alike everywhere: reported, or inside the stated ellipse?"""
    cv2.setNumThreads(1)
    table = _empty_table(preset)
    for change in (AS_DRAWN, *(name for name in SEEING if name.startswith(only))):
        runs = run_machines(Order(preset, change=change), range(seed, seed + n), folder, workers)
        table.add_row(*row_of(change, drawn(runs)))
        console.print(" | ".join(row_of(change, drawn(runs))))
    console.print(table)


def _empty_table(preset: str) -> Table:
    table = Table(title=f"preset {preset}; goal: answered >= 95 %, false alarms (as drawn) <= 1 %, confident misses 0")
    headings = (
        "off",
        "N",
        "refused",
        "reported",
        "first move held",
        "end held",
        "answered",
        "confident miss",
        "one move",
    )
    for heading in headings:
        table.add_column(heading)
    return table


def row_of(name: str, runs: Sequence[MachineRun]) -> tuple[str, ...]:
    """Refused; reported; 95 % ellipsoid of the first move and 95 % intervals of the last look hold the truth; reported
    or held; reached with more than 5 mm on an axis; inside 5 mm after one move."""
    moved = [run for run in runs if run.moves]
    shares = (
        share([run.state != "done" for run in runs]),
        share([bool(run.warning) for run in runs]),
        share([first_held(run) for run in moved]),
        share([end_held(run) for run in runs if run.end_image_mm is not None]),
        share([answered(run) for run in runs]),
        share([confident_miss(run) for run in runs]),
        share([run.inside(1) for run in runs]),
    )
    return (name, str(len(runs)), *(_in_words(rate) for rate in shares))


def first_held(run: MachineRun) -> bool:
    """Whether the 95 % ellipsoid predicted before the first move held the true error after it."""
    step = run.moves[0]
    C = np.diag(np.square(step.sigma_mm)) if step.covariance_mm2 is None else np.array(step.covariance_mm2)
    e = np.array(step.true_mm)
    return bool(e @ np.linalg.solve(C, e) <= CHI2_95_OF_3)


def end_held(run: MachineRun) -> bool:
    """Whether the last look's error ellipsoid, axes of OOI, holds the true place of the tool."""
    if run.end_true_mm is None or run.end_image_mm is None or run.end_sigma_mm is None:
        return False
    off = (np.array(run.end_true_mm) - run.end_image_mm) / run.end_sigma_mm
    return bool(off @ off <= CHI2_95_OF_3)


def answered(run: MachineRun) -> bool:
    """Reported, refused, or inside what was stated of the first move and of the end."""
    return bool(run.warning) or run.state != "done" or not run.moves or (first_held(run) and end_held(run))


def confident_miss(run: MachineRun) -> bool:
    """Reached, it says, and truly more than 5 mm off on an axis."""
    return run.reached and run.end_true_mm is not None and max(map(abs, run.end_true_mm)) > INSIDE_MM


def _in_words(rate: Share) -> str:
    return f"{100 * rate.value:.0f} % ({rate.k} of {rate.n})"
