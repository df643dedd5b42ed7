"""`longreach bench bundle`."""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from longreach.bench_bundle.cases import Judged, load_or_run
from longreach.bench_bundle.stereo_data import SETS, gtsam_data_folder, read_stereo_data
from longreach.bench_bundle.windows import adjustment_ms, joint_nees, simulated_window
from server.vision.bundle import BundleStatus, adjust_bundle

console = Console(width=160)
TIMED = ((8, 300, 5), (3, 300, 5), (2, 300, 5), (2, 300, 1))
OUTLIER_FRACS = (0.0, 0.1, 0.2)


def bundle(
    n: Annotated[int, typer.Option(help="starts of each data set and loss; the first is the files' own")] = 5,
    seed: Annotated[int, typer.Option(help="seed of the simulated windows")] = 1,
    windows: Annotated[int, typer.Option(help="simulated windows for the covariance")] = 300,
    sets: Annotated[str, typer.Option(help=f"of {', '.join(SETS)}")] = "large",
    scipy: Annotated[bool, typer.Option(help="SciPy's least squares too (seconds a case)")] = True,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-bundle"
    ),
) -> None:
    """Our bundle adjustment beside gtsam's and SciPy's on gtsam's stereo data; time per window; honest covariance."""
    judged = _races([name.strip() for name in sets.split(",")], n, scipy, folder)
    if judged:
        console.print(_race_table(judged))
    times = {f"{k} x {m}, {i} iterations": adjustment_ms(k, m, i, seed) for k, m, i in TIMED}
    for case, spent in times.items():
        console.print(f"keyframes x points {case}: {spent:.2f} CPU ms")
    honest = {f"{frac:.0%} outliers": _nees(windows, seed, frac) for frac in OUTLIER_FRACS}
    for case, (mean, done) in honest.items():
        console.print(f"NEES per degree of freedom, {case}: {mean:.3f} (honest: 1) over {done} windows of {windows}")
    folder.mkdir(parents=True, exist_ok=True)
    report = {"times_ms": times, "nees": honest, "seed": seed}
    (folder / "bundle.json").write_text(json.dumps(report, indent=1), encoding="utf-8")


def _races(names: list[str], n: int, scipy: bool, folder: Path) -> list[Judged]:
    data_folder = gtsam_data_folder()
    if data_folder is None:
        console.print("gtsam is not installed (pip install gtsam): no comparison")
        return []
    judged = []
    for name in names:
        if name not in SETS:
            raise typer.BadParameter(f"{name} is none of {', '.join(SETS)}")
        data = read_stereo_data(data_folder, name)
        cases = [(loss, start) for loss in ("squares", "huber") for start in range(n)]
        for loss, start in track(cases, description=f"set {name}", console=console):
            judged += load_or_run(data, name, loss, start, scipy, folder)
    return judged


def _race_table(judged: list[Judged]) -> Table:
    table = Table(title="The same start and noise, the first pose fixed; one independent cost", title_justify="left")
    for heading in (
        "set",
        "loss",
        "solver",
        "starts",
        "cost",
        "cost / gtsam's, worst",
        "iterations",
        "CPU ms",
        "poses apart",
    ):
        table.add_column(heading)
    for key in dict.fromkeys((one.data, one.loss, one.solver) for one in judged):
        own = [one for one in judged if (one.data, one.loss, one.solver) == key]
        table.add_row(
            *key,
            str(len(own)),
            f"{own[0].cost:.4f}",
            f"{max(one.ratio_to_gtsam for one in own):.9f}",
            f"{np.median([one.iterations for one in own]):.0f}",
            f"{np.median([one.cpu_ms for one in own]):.0f}",
            f"{max(one.way_m for one in own):.1e} m, {max(one.way_rad for one in own):.1e} rad",
        )
    return table


def _nees(windows: int, seed: int, outlier_frac: float) -> tuple[float, int]:
    """Mean NEES and how many windows ended OK."""
    found = []
    for number in range(windows):
        window = simulated_window(np.random.default_rng([seed, number]), 4, 60, outlier_frac)
        result = adjust_bundle(window.problem)
        if result.status is BundleStatus.OK:
            found.append(joint_nees(window, result))
    return float(np.mean(found)) if found else float("nan"), len(found)
