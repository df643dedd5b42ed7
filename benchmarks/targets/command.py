"""`longreach bench targets`: patches against the truth, faults, and whole jobs on bare rock."""

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, TypeVar

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from benchmarks.same_options import require_same_options, text_mark
from benchmarks.targets.faults import KINDS, FaultCase, fault_cases
from benchmarks.targets.holes import HoleCase, hole_cases
from benchmarks.targets.patches import PatchCase, wall_cases
from benchmarks.targets.rendered import NOT_CHOSEN, PointCase, point_case
from benchmarks.targets.taught_scenes import GENUINE, TaughtCase, taught_cases, taught_job
from benchmarks.targets.taught_scenes import KINDS as TAUGHT_KINDS
from benchmarks.targets.virtual_jobs import virtual_case
from machine.description import parse_machine_toml
from server.settings import read_machine_text
from server.targets.contracts import TargetSettings

CHI2_3_95 = 7.815
FOLDER = Path("runs/bench-targets")
C = TypeVar("C")


def targets(
    walls: Annotated[int, typer.Option(help="walls for patches: 24 clicks each")] = 40,
    faults: Annotated[int, typer.Option(help="walls for faults: every fault once each")] = 34,
    rendered: Annotated[int, typer.Option(help="whole jobs in real time, preset realistic")] = 0,
    holes: Annotated[int, typer.Option(help="walls with 1 to 12 boreholes and rings: two pictures each")] = 30,
    virtual: Annotated[int, typer.Option(help="whole jobs in virtual time, every look rendered")] = 0,
    taught: Annotated[int, typer.Option(help="worlds with a taught object: one look of each kind")] = 0,
    taught_jobs: Annotated[int, typer.Option(help="whole jobs on a taught object in virtual time")] = 0,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    machine: Annotated[str, typer.Option(help="machine file or name")] = "hiab033",
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = FOLDER,
) -> None:
    """Targets without markers: patch errors against stated ellipses, faults found, and point-and-go jobs."""
    console, settings = Console(width=160), TargetSettings()
    cv2.setNumThreads(1)
    text = read_machine_text(machine)
    require_same_options(folder, machine=text_mark(text))
    described = parse_machine_toml(text)
    seen = _saved(folder, "patches", range(seed, seed + walls), lambda k: wall_cases(described, k, settings), PatchCase)
    found = _saved(
        folder, "faults", range(seed, seed + faults), lambda k: fault_cases(described, k, settings), FaultCase
    )
    round_marks = _saved(
        folder, "holes", range(seed, seed + holes), lambda k: hole_cases(described, k, settings), HoleCase
    )
    driven = _saved(
        folder, "rendered", range(seed, seed + rendered), lambda k: [point_case(described, k, folder)], PointCase
    )
    stood_in = _saved(
        folder, "virtual", range(seed, seed + virtual), lambda k: _drawn(virtual_case(described, k)), PointCase
    )
    known = _saved(folder, "taught", range(seed, seed + taught), lambda k: taught_cases(described, k), TaughtCase)
    on_taught = _saved(
        folder, "taught-job", range(seed, seed + taught_jobs), lambda k: taught_job(described, k), PointCase
    )
    for rows, title in (
        (patch_rows(seen), f"patches: N = {len(seen)} clicks, {walls} walls"),
        (fault_rows(found), f"faults: N = {len(found)} looks, {faults} walls"),
        (hole_rows(round_marks), f"holes and rings: N = {len(round_marks)} marks, {holes} walls"),
        (point_rows(driven), f"point and go: N = {len(driven)} jobs"),
        (point_rows(stood_in), f"point and go in virtual time: N = {len(stood_in)} jobs"),
        (taught_rows(known), f"taught objects: N = {len(known)} looks, {taught} worlds"),
        (point_rows(on_taught), f"jobs on a taught object in virtual time: N = {len(on_taught)}"),
    ):
        table = Table("what", "share", "Wilson 95 %", title=f"{title}, seeds from {seed}", title_justify="left")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    if (
        any(case.wrong for case in found)
        or any(case.taken for case in known)
        or any(case.confidently_wrong for case in driven + stood_in + on_taught)
    ):
        raise typer.Exit(1)


def _drawn(case: C | None) -> list[C]:
    return [] if case is None else [case]


def _saved(folder: Path, name: str, seeds: range, run: Callable[[int], list[C]], kind: type[C]) -> list[C]:
    """Cases by seed, each seed saved as soon as it is done."""
    folder.mkdir(parents=True, exist_ok=True)
    cases: list[C] = []
    for seed in seeds:
        file = folder / f"{name}-{seed}.json"
        if not file.exists():
            made = json.dumps([asdict(case) for case in run(seed)])  # pyright: ignore[reportArgumentType]
            file.write_text(made, encoding="utf-8")
        cases += [kind(**row) for row in json.loads(file.read_text(encoding="utf-8"))]
    return cases


def _share(name: str, flags: Sequence[bool]) -> tuple[str, str, str]:
    if not flags:
        return name, "none", ""
    interval = binomtest(sum(flags), len(flags)).proportion_ci(0.95, "wilson")
    share = f"{sum(flags)} of {len(flags)} ({100 * sum(flags) / len(flags):.1f} %)"
    return name, share, f"{100 * interval.low:.1f} to {100 * interval.high:.1f} %"


def patch_rows(cases: Sequence[PatchCase]) -> list[tuple[str, str, str]]:
    """Refusals, errors, and whether the stated ellipses hold them, by distance and obliqueness."""
    good = [case for case in cases if case.status == "ok"]
    refusals = ", ".join(f"{name} {n}" for name, n in Counter(c.status for c in cases if c.status != "ok").items())
    rows = [
        _share(f"measured (refused: {refusals or 'none'})", [case.status == "ok" for case in cases]),
        _share("normal within 2 deg", [case.normal_deg <= 2.0 for case in good]),
        _share("95 % ellipsoid holds the position", [case.holds_position for case in good]),
        _share("95 % ellipse holds the normal", [case.holds_normal for case in good]),
    ]
    parts: list[tuple[str, Callable[[PatchCase], bool]]] = [
        ("camera nearer than 1.0 m", lambda case: case.distance_m < 1.0),
        ("camera at 1.0 m or more", lambda case: case.distance_m >= 1.0),
        ("below 15 deg oblique", lambda case: case.oblique_deg < 15.0),
        ("15 deg oblique or more", lambda case: case.oblique_deg >= 15.0),
    ]
    for name, wanted in parts:
        some = [case for case in good if wanted(case)]
        rows.append(_share(f"position held, {name}", [case.holds_position for case in some]))
        rows.append(_share(f"normal held, {name}", [case.holds_normal for case in some]))
    if good:
        depth, normal = [abs(case.depth_mm) for case in good], [case.normal_deg for case in good]
        rows.append(("depth error, median and 95 %", f"{np.median(depth):.2f}, {np.quantile(depth, 0.95):.2f} mm", ""))
        rows.append(
            ("normal error, median and 95 %", f"{np.median(normal):.2f}, {np.quantile(normal, 0.95):.2f} deg", "")
        )
    return rows


def fault_rows(cases: Sequence[FaultCase]) -> list[tuple[str, str, str]]:
    """Each fault's share found, and poses that were served and wrong."""
    rows = [
        _share(f"{kind}: found" if kind != "none" else "without a fault: served", _flags(cases, kind)) for kind in KINDS
    ]
    return [*rows, _share("served and more than 5 mm off", [case.wrong for case in cases])]


def _flags(cases: Sequence[FaultCase], kind: str) -> list[bool]:
    return [case.found if kind != "none" else not case.found for case in cases if case.kind == kind]


def hole_rows(cases: Sequence[HoleCase]) -> list[tuple[str, str, str]]:
    """Found and false shares, errors and coverage, with the camera at about 0.6 m and at about 1 m."""
    rows = []
    for near, name in ((True, "about 0.6 m"), (False, "about 1 m")):
        some = [case for case in cases if case.near == near]
        seen = [case for case in some if case.visible]
        found = [case for case in some if case.found]
        good = [case for case in found if case.status == "ok"]
        refused = ", ".join(f"{k} {n}" for k, n in Counter(c.status for c in found if c.status != "ok").items())
        rows += [
            _share(f"{name}: found of the visible", [case.found for case in seen]),
            _share(f"{name}: false of the found", [case.kind == "false" for case in found]),
            _share(f"{name}: measured of the found (refused: {refused or 'none'})", [c.status == "ok" for c in found]),
        ]
        good = [case for case in good if case.kind != "false"]
        rows += [
            _share(f"{name}: centre within 1 mm", [case.centre_mm <= 1.0 for case in good]),
            _share(f"{name}: axis within 2 deg", [case.axis_deg <= 2.0 for case in good]),
            _share(f"{name}: 95 % ellipsoid holds the centre", [case.holds_centre for case in good]),
            _share(f"{name}: 95 % ellipse holds the axis", [case.holds_axis for case in good]),
        ]
        for what, unit in (("centre_mm", "mm"), ("axis_deg", "deg")):
            values = [getattr(case, what) for case in good]
            if values:
                quantiles = ", ".join(f"{value:.2f}" for value in np.quantile(values, [0.5, 0.95, 1.0]))
                rows.append(
                    (f"{name}: {what[: -len(unit) - 1]} error, median, 95 % and largest", f"{quantiles} {unit}", "")
                )
    return rows


def taught_rows(cases: Sequence[TaughtCase]) -> list[tuple[str, str, str]]:
    """Recall, look-alikes taken, pose errors and whether the stated ellipsoids hold them."""
    genuine = [case for case in cases if case.kind in GENUINE]
    rows = [_share("recall: object served", [case.served for case in genuine])]
    for kind in TAUGHT_KINDS:
        name = f"{kind}: served" if kind in GENUINE else f"{kind}: taken"
        rows.append(_share(name, [case.served for case in cases if case.kind == kind]))
    good = [case for case in genuine if case.served]
    if good:
        mm, deg = [case.position_mm for case in good], [case.rotation_deg for case in good]
        rows += [
            _share("95 % ellipsoid holds the position", [case.chi2_position <= CHI2_3_95 for case in good]),
            _share("95 % ellipsoid holds the rotation", [case.chi2_rotation <= CHI2_3_95 for case in good]),
            ("position error, median and 95 %", f"{np.median(mm):.2f}, {np.quantile(mm, 0.95):.2f} mm", ""),
            ("rotation error, median and 95 %", f"{np.median(deg):.2f}, {np.quantile(deg, 0.95):.2f} deg", ""),
        ]
    return rows


def point_rows(cases: Sequence[PointCase]) -> list[tuple[str, str, str]]:
    """One-move success, refusals, and jobs that ended sure and wrong."""
    chosen = [case for case in cases if case.state != NOT_CHOSEN]
    driven: list[Any] = [case for case in chosen if case.true_mm]
    return [
        _share("a measured and reachable place was found by the clicks", [case.state != NOT_CHOSEN for case in cases]),
        _share("job after an accepted preview ended with a look", [bool(case.true_mm) for case in chosen]),
        _share("truly inside 5 mm on each axis after one move, of those", [case.inside_after_one for case in driven]),
        _share(
            "reached by its own word and truly outside", [case.reached and case.confidently_wrong for case in driven]
        ),
    ]
