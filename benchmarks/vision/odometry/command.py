"""`longreach bench odometry`: rendered paths and disturbed ones; `--features N`: honest covariances without images."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks.vision.odometry.cases import DISTANCES_M, disturbed_runs, kept, plain_runs
from benchmarks.vision.odometry.features import POSES_PER_RUN, READOUT_S, held, run_points
from benchmarks.vision.odometry.film import Film, FilmCase, render_film
from benchmarks.vision.odometry.gaps import gap_case, run_gap
from benchmarks.vision.odometry.run import Run, run_film
from benchmarks.vision.odometry.structure import StructureRun, run_structure, structure_runs
from recording.files import write_durably

Case = dict[str, Any]
SUMMARY = "summary.json"


def odometry(
    n: Annotated[int, typer.Option(help="seeds; each is 8 paths: 2 shapes at 4 distances")] = 4,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    features: Annotated[int, typer.Option(help="instead: this many poses of simulated points")] = 0,
    rolling: Annotated[bool, typer.Option(help="simulated points: with a rolling shutter of 11 ms")] = False,
    structure: Annotated[int, typer.Option(help="instead: so many paths at each share of own structure")] = 0,
    gaps: Annotated[int, typer.Option(help="instead: so many gaps over a wall that repeats itself")] = 0,
    disturbed: Annotated[bool, typer.Option(help="also the first seed's disturbed runs")] = True,
    rate_hz: Annotated[float, typer.Option(help="pairs per second that are rendered")] = 30.0,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-odometry"
    ),
) -> None:
    """Stereo odometry on rendered paths of preset realistic, without markers, calibration exact."""
    console = Console(width=200)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        if features:
            report = bench_features(features, seed, READOUT_S if rolling else 0.0, folder, console)
        elif structure:
            report = bench_structure(structure, seed, folder, console)
        elif gaps:
            report = bench_gaps(gaps, seed, folder, console)
        else:
            report = bench_paths(n, seed, rate_hz, disturbed, folder, console)
    finally:
        cv2.setNumThreads(threads)
    (folder / SUMMARY).write_text(json.dumps(report, indent=1), encoding="utf-8")


def bench_paths(n: int, seed: int, rate_hz: float, disturbed: bool, folder: Path, console: Console) -> Case:
    """Render or resume all runs and print them; a film is rendered once for all runs on it."""
    runs = [*plain_runs(n, seed, rate_hz), *(disturbed_runs(seed, rate_hz) if disturbed else ())]
    films: dict[str, Film] = {}

    def work(run: Run) -> Case:
        if run.film.name not in films:
            films.clear()  # one at a time: they are large
            films[run.film.name] = render_film(run.film)
        return run_film(run, films[run.film.name])

    named = {run.name: run for run in sorted(runs, key=lambda run: (run.film.seed, run.film.name))}
    cases = _resumed(named, work, folder / "paths", console)
    console.print(_paths_table(cases))
    plain = [case for case in cases if case["name"] == FilmCase(**case["film"]).name and _is_plain(case)]
    shares = {
        half: float(np.average([c["figures"][half] for c in plain], weights=[c["figures"]["n_pairs"] for c in plain]))
        for half in ("held_position", "held_rotation")
    }
    console.print(
        f"{sum(kept(case) for case in cases)} of {len(cases)} runs inside their bounds; N reached {len(cases)} of "
        f"{len(runs)}; {len(plain)} plain paths hold {shares['held_position']:.3f} of positions and "
        f"{shares['held_rotation']:.3f} of rotations in their 95 % ellipsoids; {rate_hz:g} Hz"
    )
    return {"n": len(cases), "wanted": len(runs), "held": shares, "cases": cases}


def _is_plain(case: Case) -> bool:
    film = case["film"]
    return not film["disparity_bias_px"] and film["contrast_frac"] is None


def bench_structure(n: int, seed: int, folder: Path, console: Console) -> Case:
    """Paths with the crane's own structure in the picture, without and with a proposed mask."""
    runs, films = structure_runs(n, seed), dict[str, Film]()

    def work(run: StructureRun) -> Case:
        if run.film.name not in films:
            films.clear()
            films[run.film.name] = render_film(run.film)
        return run_structure(run, films[run.film.name])

    cases = _resumed({run.name: run for run in runs}, work, folder / "structure", console)
    table = Table(title="Own structure in the picture; wrong: by 4 sigma and 2 mm while OK")
    for heading in (
        "share",
        "mask",
        "paths",
        "poses",
        "wrong",
        "DEGRADED or LOST %",
        "paths with wrong",
        "max mm while OK",
    ):
        table.add_column(heading)
    kinds = sorted({(case["film"]["structure_frac"], case["masked"]) for case in cases})
    for frac, masked in kinds:
        some = [case for case in cases if (case["film"]["structure_frac"], case["masked"]) == (frac, masked)]
        poses, wrong = sum(sum(case["states"].values()) for case in some), sum(case["wrong"] for case in some)
        good = sum(case["states"]["ok"] for case in some)
        table.add_row(
            f"{frac:g}",
            "proposed" if masked else "none",
            *(str(value) for value in (len(some), poses, wrong)),
            f"{100.0 * (1.0 - good / poses):.1f}",
            str(sum(case["wrong"] > 0 for case in some)),
            f"{max(case['worst_mm'] for case in some):.2f}",
        )
    console.print(table)
    return {"n": len(cases), "wanted": len(runs), "cases": cases}


def bench_gaps(n: int, seed: int, folder: Path, console: Console) -> Case:
    """Gaps while the camera moves on over equal bricks."""
    named = {case.name: case for case in map(gap_case, range(seed, seed + n))}
    cases = _resumed(named, run_gap, folder / "gaps", console)
    states = {state: sum(case["states"][state] for case in cases) for state in cases[0]["states"]} if cases else {}
    wrong = sum(case["wrong"] > 0 for case in cases)
    worst_mm = max((case["worst_mm"] for case in cases), default=0.0)
    console.print(
        f"{len(cases)} gaps over a wall that repeats itself: wrong by 4 sigma and 2 mm while OK after {wrong}; poses "
        f"after them by state {states}; at most {worst_mm:.2f} mm off while OK"
    )
    return {"n": len(cases), "wanted": n, "cases": cases}


def bench_features(n_poses: int, seed: int, readout_s: float, folder: Path, console: Console) -> Case:
    """Coverage over n poses of short independent runs."""
    n_runs = -(-n_poses // POSES_PER_RUN)
    named = {f"{seed + k}-{1e3 * readout_s:g}ms": seed + k for k in range(n_runs)}
    cases = _resumed(named, lambda number: run_points(number, readout_s=readout_s), folder / "features", console)
    halves = {half: np.concatenate([case[f"{half}_chi2"] for case in cases]) for half in ("position", "rotation")}
    report: Case = {"n_poses": len(halves["position"]), "n_runs": len(cases), "readout_s": readout_s}
    table = Table(title=f"{report['n_poses']} poses of {len(cases)} runs, readout {1e3 * readout_s:g} ms")
    for heading in ("", "50 % hold", "95 % hold", "99 % hold", "mean chi2 (3)"):
        table.add_column(heading)
    for half, squares in halves.items():
        figures = [held(squares, share) for share in (0.5, 0.95, 0.99)]
        report[half] = {"held_95": figures[1], "mean_chi2": float(squares.mean())}
        table.add_row(half, *(f"{figure:.3f}" for figure in figures), f"{squares.mean():.2f}")
    console.print(table)
    keyframes = np.bincount([case["n_keyframes"] for case in cases])
    console.print(f"runs by number of keyframes: {dict(enumerate(keyframes.tolist()))}; N reached {len(cases)} runs")
    return report


def _resumed(named: dict[str, Any], work: Callable[[Any], Case], folder: Path, console: Console) -> list[Case]:
    """Every case from its file or from work; Ctrl-C ends early with what is there."""
    folder.mkdir(parents=True, exist_ok=True)
    cases = []
    with Progress(console=console) as progress:
        try:
            for name, what in progress.track(named.items(), description="runs"):
                path = folder / f"{name}.json"
                if not path.is_file():
                    write_durably(path, json.dumps(work(what)))
                cases.append(json.loads(path.read_text(encoding="utf-8")))
        except KeyboardInterrupt:
            console.print("ended early; the next run goes on from here")
    return cases


def _paths_table(cases: Iterable[Case]) -> Table:
    distances = ", ".join(f"{d:g}" for d in DISTANCES_M)
    table = Table(title=f"Odometry on rendered paths ({distances} m), errors in its own start frame")
    for heading in (
        "run", "pairs", "OK", "LOST", "keyframes", "max mm", "end mm", "max deg", "scale %",
        "held pos", "held rot", "worst sigma", "ms", "ms p99", "kept",
    ):  # fmt: skip
        table.add_column(heading)
    for case in cases:
        f = case["figures"]
        table.add_row(
            case["name"],
            *(str(f[name]) for name in ("n_pairs", "n_ok", "n_lost", "n_keyframes")),
            *(f"{f[name]:.2f}" for name in ("max_mm", "end_mm")),
            f"{f['max_deg']:.3f}",
            f"{100.0 * f['scale_frac']:+.3f}",
            *(f"{f[name]:.2f}" for name in ("held_position", "held_rotation", "worst_sigma")),
            *(f"{f[name]:.1f}" for name in ("ms_median", "ms_p99")),
            "yes" if kept(case) else "NO",
        )
    return table
