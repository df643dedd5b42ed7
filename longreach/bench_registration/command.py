"""`longreach bench registration`."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from longreach.bench_registration.intervals import Interval, percentile_interval, ratio_interval
from longreach.bench_registration.methods import METHODS, OURS, available_methods
from longreach.bench_registration.run import CELLS, Cell, Trials, run_trials
from machine.rotations import Array

CHI2_95_OF_3 = 7.815
WITHIN = 1.05
console = Console(width=190)


@dataclass(frozen=True, slots=True)
class CellFigures:
    """One row: each method's median and 95 % [deg], time [ms], refusals; ours against the best other; our honesty."""

    n: int
    median_deg: dict[str, Interval]
    p95_deg: dict[str, Interval]
    median_ms: dict[str, float]
    refused: dict[str, int]
    best_other: str
    median_over_best: Interval
    best_other_p95: str
    p95_over_best: Interval
    nees: float
    held_95_frac: float
    offset_error_ms: float


def registration(
    n: Annotated[int, typer.Option(help="trials of each row")] = 1000,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    workers: Annotated[int, typer.Option(help="processes")] = 1,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-registration"
    ),
) -> None:
    """Our chords beside mixture model, Umeyama (evo) and CPD (pycpd): rotation error and time on simulated tracks."""
    for name in METHODS:
        if name not in available_methods():
            console.print(f"{name}: package not installed, column left out")
    with Progress(console=console) as progress:
        task = progress.add_task("trials", total=n * len(CELLS))
        found = run_trials(n, seed, folder, workers, lambda done: progress.advance(task, done))
    figures = {cell: cell_figures(trials) for cell, trials in found.items()}
    console.print(_errors(figures))
    console.print(_verdicts(figures))
    console.print(f"N reached: {min(one.n for one in figures.values())} in every row")
    report = {" / ".join(cell): asdict(one) for cell, one in figures.items()}
    (folder / "registration.json").write_text(json.dumps(report, indent=1), encoding="utf-8")


def cell_figures(trials: Trials) -> CellFigures:
    """Medians, percentiles and comparisons over the trials of one row; a refusal counts as the worst error."""
    names = list(next(iter(trials.values())))
    errors = {name: _errors_of(trials, name) for name in names}
    # the mixture with axes answers with what it was told, its error is that of the mounting we draw: no rival
    others = [name for name in names if name not in (OURS, "chords 8 cm", "HMM with axes")]
    median = {name: percentile_interval(errors[name], 50.0) for name in names}
    p95 = {name: percentile_interval(errors[name], 95.0) for name in names}
    best, best_p95 = (min(others, key=lambda name: figures[name].value) for figures in (median, p95))
    ours = [by_method[OURS] for by_method in trials.values()]
    chi2 = np.array([one.chi2 for one in ours if one.chi2 is not None])
    offsets = [abs(one.offset_error_s) for one in ours if one.offset_error_s is not None]
    return CellFigures(
        n=len(trials),
        median_deg=median,
        p95_deg=p95,
        median_ms={name: 1e3 * float(np.median([one[name].seconds for one in trials.values()])) for name in names},
        refused={name: int(np.isinf(errors[name]).sum()) for name in names},
        best_other=best,
        median_over_best=ratio_interval(errors[OURS], errors[best], 50.0),
        best_other_p95=best_p95,
        p95_over_best=ratio_interval(errors[OURS], errors[best_p95], 95.0),
        nees=float(chi2.mean() / 3.0) if len(chi2) else float("nan"),
        held_95_frac=float(np.mean(chi2 < CHI2_95_OF_3)) if len(chi2) else float("nan"),
        offset_error_ms=1e3 * float(np.median(offsets)) if offsets else float("nan"),
    )


def _errors_of(trials: Trials, name: str) -> Array:
    found = [by_method[name].error_deg for by_method in trials.values()]
    return np.array([np.inf if error is None else error for error in found])


def _errors(figures: dict[Cell, CellFigures]) -> Table:
    names = list(next(iter(figures.values())).median_deg)
    table = Table(title="rotation error, median / 95 % in deg; time per call, median in ms", title_justify="left")
    for heading in ("row", "path", *names):
        table.add_column(heading)
    for (kind, path), one in figures.items():
        cells = [f"{one.median_deg[name].value:.2f} / {one.p95_deg[name].value:.2f}" for name in names]
        table.add_row(kind, path, *cells)
    times = [f"{np.median([one.median_ms[name] for one in figures.values()]):.0f} ms" for name in names]
    table.add_section()
    table.add_row("time", "all", *times)
    table.caption = "HMM with axes returns the mounting it is told, here 4 deg wrong; 'chords 8 cm': our former one"
    return table


def _verdicts(figures: dict[Cell, CellFigures]) -> Table:
    table = Table(title="ours: with 95 % intervals, and against the best other method", title_justify="left")
    for heading in ("row", "path", "median deg", "95 % deg", "best other", "median ratio", "95 % ratio", "verdict"):
        table.add_column(heading)
    for heading in ("refused", "NEES", "held in 95 %", "offset off ms"):
        table.add_column(heading)
    for (kind, path), one in figures.items():
        table.add_row(
            kind,
            path,
            _shown(one.median_deg[OURS]),
            _shown(one.p95_deg[OURS]),
            one.best_other,
            _shown(one.median_over_best),
            _shown(one.p95_over_best),
            verdict(one.median_over_best),
            str(one.refused[OURS]),
            f"{one.nees:.2f}",
            f"{100 * one.held_95_frac:.1f} %",
            f"{one.offset_error_ms:.1f}",
        )
    table.caption = "NEES: squared error over covariance by 3, 1 is exact, below is cautious"
    return table


def _shown(one: Interval) -> str:
    return f"{one.value:.2f} ({one.low:.2f}-{one.high:.2f})"


def verdict(ratio: Interval) -> str:
    """Ours over the best other: best when the interval lies below 1, within 5 % when it lies below 1.05."""
    if ratio.high < 1.0:
        return "best"
    if ratio.value <= WITHIN:
        return "within 5 %" if ratio.high <= WITHIN else "within 5 %, interval wider"
    return "not best"
