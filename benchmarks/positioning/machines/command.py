"""`longreach bench machines` and `longreach bench ablation`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from benchmarks.positioning.machines.figures import (
    Accuracy,
    Honesty,
    accuracy,
    disobedient,
    drawn,
    honesty,
    refusals,
    seconds,
    two_made,
    worst,
)
from benchmarks.positioning.machines.machine_run import LOOK_MIN_M, PATH_MIN_M, MachineRun
from benchmarks.positioning.machines.paired import paired_change
from benchmarks.positioning.machines.saved import Order, run_machines
from benchmarks.positioning.machines.variants import ABLATIONS, DEFAULT
from benchmarks.reproduce.summary import Share, share
from machine.rotations import Array

console = Console(width=190)
GOALS = {1: ">= 75 % (goal 90)", 2: ">= 97 %", 3: ">= 99.5 %"}
Folder = Annotated[Path, typer.Option(help="where every machine is saved; a second run resumes")]
FOLDER = Path("runs/bench-machines")


def machines(
    preset: Annotated[str, typer.Option(help="ideal, realistic or paper")] = "realistic",
    n: Annotated[int, typer.Option(help="machines")] = 1000,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    workers: Annotated[int, typer.Option(help="processes")] = 1,
    fine: Annotated[bool, typer.Option(help="the fine plant with oil, swing and stiction; five times slower")] = False,
    again: Annotated[bool, typer.Option(help="and a second move, and once more with its calibration kept")] = True,
    folder: Folder = FOLDER,
) -> None:
    """The default method on many machines in the fast world: success by moves, refusals, honest ellipses, times."""
    cv2.setNumThreads(1)
    with _progress() as progress:
        task = progress.add_task(f"{preset}{', fine plant' if fine else ''}", total=n)
        order = Order(preset, again=again, fine=fine)
        runs = run_machines(order, range(seed, seed + n), folder, workers, lambda done: progress.advance(task, done))
    console.print(f"preset {preset}, seeds {seed} to {seed + n - 1}: N reached {len(drawn(runs))}")
    tell(runs)


def ablation(
    preset: Annotated[str, typer.Option(help="ideal, realistic or paper")] = "realistic",
    n: Annotated[int, typer.Option(help="machines of each variant")] = 200,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    workers: Annotated[int, typer.Option(help="processes")] = 1,
    only: Annotated[str, typer.Option(help="variants by name, comma between them; empty: all")] = "",
    folder: Folder = FOLDER,
) -> None:
    """Each improvement switched off alone, on the same machines: change of the one-move success."""
    cv2.setNumThreads(1)
    wanted = [name.strip() for name in only.split(",") if name.strip()]
    unknown = set(wanted) - {one.name for one in ABLATIONS}
    if unknown:
        raise typer.BadParameter(f"no variant {sorted(unknown)}; there are: {', '.join(one.name for one in ABLATIONS)}")
    chosen = [one for one in ABLATIONS if not wanted or one.name in wanted]
    seeds = range(seed, seed + n)
    found: dict[str, list[MachineRun]] = {}
    with _progress() as progress:
        task = progress.add_task("variants", total=n * (1 + len(chosen)))
        for one in (DEFAULT, *chosen):
            progress.update(task, description=one.name)
            order = Order(preset, one.name)
            found[one.name] = run_machines(order, seeds, folder, workers, lambda done: progress.advance(task, done))
    console.print(ablation_table(found))


def tell(runs: Sequence[MachineRun]) -> None:
    """Everything about one set of runs."""
    usable = drawn(runs)
    if len(usable) < len(runs):
        console.print(f"no usable scene for {len(runs) - len(usable)} seeds: not counted")
    refused = share([run.state != "done" for run in usable])
    console.print(f"refused: {share_text(refused)}, counted as failures (limit 2 %)")
    for reason, seeds in refusals(runs):
        console.print(f"  {len(seeds)} x {reason} (seeds {', '.join(map(str, seeds[:8]))})")
    near = disobedient(runs)
    console.print(
        f"last look nearer than {LOOK_MIN_M:.2f} m or calibration path nearer than {PATH_MIN_M:.2f} m to the goal: "
        f"{len(near)} machines{', not counted below' if near else ''}"
    )
    counted = [run for run in usable if run.seed not in set(near)]
    if any(run.moves for run in counted):
        looks, paths = (
            [getattr(run, at) for run in counted if run.moves] for at in ("last_look_goal_m", "path_goal_m")
        )
        console.print(f"  nearest last look {min(looks):.2f} m, nearest calibration path {min(paths):.2f} m")
        console.print(accuracy_table([accuracy(counted, moves) for moves in (1, 2, 3)]))
        made = two_made(counted)
        if made is not None:
            console.print(
                f"two moves made, needed or not: inside {share_text(made.inside)}; "
                f"median 3-D {made.median_3d_mm:.2f} mm, 95 % of |z| {made.p95_z_mm:.2f} mm, "
                f"95 % of rotation {made.p95_deg:.2f} deg"
            )
        console.print(honesty_table(honesty(counted)))
        for number, step in worst(counted, 1, 5):
            x, y, z = step.true_mm
            console.print(f"  worst: seed {number}: {x:+.1f} {y:+.1f} {z:+.1f} mm, sigma {_three(step.sigma_mm)}")
        (middle, high), (middle_again, high_again) = seconds(counted)
        console.print(
            f"seconds from the first look to rest on target: median {middle:.0f}, 95 % {high:.0f} with calibration "
            f"(goal 90); median {middle_again:.0f}, 95 % {high_again:.0f} with one kept (goal 30)"
        )


def accuracy_table(rows: Sequence[Accuracy]) -> Table:
    """Success and true errors within one, two, three moves."""
    table = Table(title="true errors at rest, OOI axes", title_justify="left")
    for heading in (
        "moves",
        "|x|, |y| <= 5 mm",
        "wanted",
        "mean |x|, |y|, |z| mm",
        "median 3-D mm",
        "95 % |z| mm",
        "95 % rotation deg",
    ):
        table.add_column(heading)
    for row in rows:
        numbers = (f"{row.median_3d_mm:.2f}", f"{row.p95_z_mm:.2f}", f"{row.p95_deg:.2f}")
        table.add_row(str(row.moves), share_text(row.inside), GOALS[row.moves], _three(row.mean_mm), *numbers)
    table.caption = "wanted after two: median 3-D <= 1.5 mm, 95 % of |z| <= 2 mm, 95 % of rotation <= 0.5 deg"
    return table


def honesty_table(found: Honesty) -> Table:
    """What the 95 % predictions made before the first move hold."""
    table = Table(title=f"95 % prediction before the first move, N = {found.n} (wanted: holds 93 to 97 %)")
    for heading in ("x", "y", "z", "all axes", "3-D ellipsoid", "NEES / 3", "rms error over sigma, x y z"):
        table.add_column(heading)
    shares = [share_text(one) for one in (*found.axes, found.pooled, found.ellipsoid)]
    table.add_row(*shares, f"{found.nees:.2f}", " ".join(f"{value:.2f}" for value in found.ratio))
    return table


def ablation_table(found: dict[str, list[MachineRun]]) -> Table:
    """One row a variant, beside the default on the same machines."""
    default = drawn(found[DEFAULT.name])
    table = Table(title=f"each switched off alone, N = {len(default)} machines", title_justify="left")
    headings = (
        "without",
        "what",
        "one move inside",
        "change",
        "95 %",
        "lost : won",
        "refused",
        "mean |x|, |y|, |z| mm",
    )
    for heading in headings:
        table.add_column(heading)
    before = [run.inside(1) for run in default]
    for name, runs in found.items():
        usable = drawn(runs)
        change = paired_change(before, [run.inside(1) for run in usable])
        got = accuracy(usable, 1)
        table.add_row(
            name,
            next(one.what for one in (DEFAULT, *ABLATIONS) if one.name == name),
            share_text(got.inside),
            f"{100 * change.value:+.1f}",
            f"{100 * change.low:+.1f} to {100 * change.high:+.1f}",
            f"{change.only_default} : {change.only_other}",
            str(sum(run.state != "done" for run in usable)),
            _three(got.mean_mm),
        )
    return table


def share_text(one: Share) -> str:
    """A share with its interval, in per cent."""
    return f"{100 * one.value:.1f} % ({100 * one.low:.1f} to {100 * one.high:.1f}), {one.k} of {one.n}"


def _three(values: Sequence[float] | Array) -> str:
    x, y, z = values
    return f"{x:.1f} {y:.1f} {z:.1f}"


def _progress() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, TimeRemainingColumn(), console=console)
