"""`longreach bench camera-faults`: the table of faults."""

import json
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import cv2
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks.same_options import require_same_options, text_mark
from benchmarks.saved_lines import add_line, open_to_add, whole_lines
from benchmarks.vision.camera_faults.case import AT_REST_ONLY, IN_MOTION_ONLY, FaultCase, run_case
from benchmarks.vision.camera_faults.damaged import DAMAGES, QUALITIES, DamagedCase, run_damaged
from benchmarks.vision.camera_faults.good import GOOD_KINDS, GoodCase, run_good
from benchmarks.vision.camera_faults.pictures import render_pictures
from machine.description import Machine, parse_machine_toml
from server.settings import read_machine_text
from sim_plc.camera.faults import FaultKind

FAULTS_FILE, GOOD_FILE, DAMAGED_FILE = "faults.jsonl", "good.jsonl", "damaged.jsonl"
KINDS = [kind for kind in FaultKind if kind not in (FaultKind.NONE, FaultKind.FLIPPED)]  # many flipped bits do no harm
FOLDER = Path("runs/bench-camera-faults")
ALARMS_PER = 10_000
NAME_WIDTH = 70

Key = tuple[str, int, bool]


def camera_faults(
    n: Annotated[int, typer.Option(help="seeds; each fault comes at rest and in motion for each")] = 5,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    good: Annotated[int, typer.Option(help="good pairs for false alarms, over all kinds of scene and seeds")] = 10_000,
    machine: Annotated[str, typer.Option(help="machine file or name")] = "hiab033",
    damaged: Annotated[int, typer.Option(help="pictures with damaged data, over all kinds and qualities")] = 2_000,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = FOLDER,
) -> None:
    """Inject every camera fault: pairs until it is found, looks that used it, pairs until recovery, false alarms."""
    console = Console(width=200)
    cv2.setNumThreads(1)
    text = read_machine_text(machine)
    require_same_options(folder, machine=text_mark(text))
    described = parse_machine_toml(text)
    cases = bench(described, KINDS, range(seed, seed + n), folder, console)
    calm = bench_good(described, range(seed, seed + n), good, folder, console)
    broken = bench_damaged(described, seed, damaged, folder, console)
    console.print(table_of(cases))
    console.print(table_of_good(calm))
    console.print(table_of_damaged(broken))
    used = sum(case.n_used for case in cases)
    missed = sum(case.found_after is None for case in cases)
    wrong = sum(case.wrong_looks for case in broken)
    result = {"used": used, "missed": missed, "cases": len(cases), "alarms": sum(one.alarms for one in calm)}
    result |= {"damaged": sum(case.damaged for case in broken), "wrong_looks": wrong}
    (folder / "result.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    console.print(
        f"faulty pairs in a look that ended OK: {used}; faults not found: {missed}; N reached {len(cases)} cases, "
        f"seeds {seed}..{seed + n - 1}; looks that ended OK with a wrong pose by damaged pictures: {wrong}, N reached "
        f"{result['damaged']} pictures"
    )
    if used or missed or wrong:
        raise typer.Exit(1)


def wanted_cases(kinds: Iterable[FaultKind], seeds: Iterable[int]) -> list[Key]:
    """Every fault at rest and in motion, but for those that only one of the two can show."""
    return [
        (kind.value, seed, moving)
        for seed in seeds
        for kind in kinds
        for moving in (False, True)
        if not (moving and kind in AT_REST_ONLY) and not (not moving and kind in IN_MOTION_ONLY)
    ]


def bench(
    machine: Machine, kinds: Sequence[FaultKind], seeds: Iterable[int], folder: Path, console: Console
) -> list[FaultCase]:
    """Run or resume; every case is saved as soon as it is there. Ctrl-C ends it early."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FAULTS_FILE
    wanted = wanted_cases(kinds, seeds)
    cases = {(case.kind, case.seed, case.moving): case for case in (FaultCase(**one) for one in whole_lines(path))}
    missing = [key for key in wanted if key not in cases]
    try:
        with Progress(console=console) as progress, open_to_add(path) as file:
            task = progress.add_task("faults", total=len(wanted), completed=len(wanted) - len(missing))
            for seed in sorted({key[1] for key in missing}):
                pictures = render_pictures(machine, seed)
                for kind, _, moving in [key for key in missing if key[1] == seed]:
                    case = run_case(machine, pictures, FaultKind(kind), seed, moving)
                    cases[kind, seed, moving] = case
                    add_line(file, asdict(case))
                    progress.advance(task)
    except KeyboardInterrupt:
        console.print("ended early; the next run goes on from here")
    return [cases[key] for key in wanted if key in cases]


def bench_good(machine: Machine, seeds: Sequence[int], pairs: int, folder: Path, console: Console) -> list[GoodCase]:
    """Good pairs of every kind of scene, shared out over the seeds."""
    path = folder / GOOD_FILE
    each = max(1, pairs // max(1, len(GOOD_KINDS) * len(seeds)))
    cases = {(case.kind, case.seed, case.pairs): case for case in (GoodCase(**one) for one in whole_lines(path))}
    wanted = [(kind, seed, each) for seed in seeds for kind in GOOD_KINDS]
    try:
        with Progress(console=console) as progress, open_to_add(path) as file:
            task = progress.add_task("good pairs", total=len(wanted))
            for key in wanted:
                if key not in cases:
                    cases[key] = run_good(machine, *key)
                    add_line(file, asdict(cases[key]))
                progress.advance(task)
    except KeyboardInterrupt:
        console.print("ended early; the next run goes on from here")
    return [cases[key] for key in wanted if key in cases]


def bench_damaged(machine: Machine, seed: int, pictures: int, folder: Path, console: Console) -> list[DamagedCase]:
    """Damaged pictures, shared out over kinds and qualities."""
    path = folder / DAMAGED_FILE
    each = -(-pictures // (len(DAMAGES) * len(QUALITIES)))
    wanted = [(kind, quality, seed, each) for kind in DAMAGES for quality in QUALITIES] if pictures else []
    saved = [DamagedCase(**one) for one in whole_lines(path)]
    cases = {(case.kind, case.quality, case.seed, case.damaged): case for case in saved}
    rendered = render_pictures(machine, seed) if any(key not in cases for key in wanted) else None
    try:
        with Progress(console=console) as progress, open_to_add(path) as file:
            task = progress.add_task("damaged pictures", total=len(wanted))
            for key in wanted:
                if key not in cases and rendered is not None:
                    cases[key] = run_damaged(machine, rendered, *key)
                    add_line(file, asdict(cases[key]))
                progress.advance(task)
    except KeyboardInterrupt:
        console.print("ended early; the next run goes on from here")
    return [cases[key] for key in wanted if key in cases]


def table_of(cases: Sequence[FaultCase]) -> Table:
    """One row per fault."""
    table = Table(title="camera faults, pairs at 30 per second", title_justify="left")
    for heading in ("fault", "cases", "found", "median", "worst", "faulty pairs used", "recovery", "worst", "named"):
        table.add_column(heading)
    for kind in dict.fromkeys(case.kind for case in cases):
        of_kind = [case for case in cases if case.kind == kind]
        found = [case.found_after for case in of_kind if case.found_after is not None]
        recovered = [case.recovered_after for case in of_kind if case.recovered_after is not None]
        table.add_row(
            kind,
            str(len(of_kind)),
            str(len(found)),
            f"{statistics.median(found):g}" if found else "-",
            str(max(found)) if found else "-",
            str(sum(case.n_used for case in of_kind)),
            f"{statistics.median(recovered):g}" if recovered else "-",
            str(max(recovered)) if len(recovered) == len(of_kind) else f"none in {len(of_kind) - len(recovered)}",
            next((case.name for case in of_kind if case.name), "")[:NAME_WIDTH],
        )
    return table


def table_of_good(cases: Sequence[GoodCase]) -> Table:
    """One row per kind of scene."""
    table = Table(title="good pairs", title_justify="left")
    for heading in ("scene", "pairs", "false alarms", f"per {ALARMS_PER}", "named"):
        table.add_column(heading)
    for kind in dict.fromkeys(case.kind for case in cases):
        of_kind = [case for case in cases if case.kind == kind]
        pairs, alarms = sum(case.pairs for case in of_kind), sum(case.alarms for case in of_kind)
        named = next((text for case in of_kind for text in case.texts), "")
        table.add_row(kind, str(pairs), str(alarms), f"{ALARMS_PER * alarms / pairs:.1f}", named[:NAME_WIDTH])
    return table


def table_of_damaged(cases: Sequence[DamagedCase]) -> Table:
    """One row per kind of damage."""
    table = Table(title="pictures with damaged data, at rest", title_justify="left")
    headings = (
        "damage",
        "pictures",
        "refused",
        "pair kept from looks",
        "wrong pair usable",
        "looks OK",
        "of them wrong",
    )
    for heading in (*headings, "sound pictures", "of them refused"):
        table.add_column(heading)
    for kind in dict.fromkeys(case.kind for case in cases):
        of_kind = [case for case in cases if case.kind == kind]
        names = ("damaged", "refused", "held", "wrong_used", "looks", "wrong_looks", "sound", "sound_refused")
        table.add_row(kind, *(str(sum(getattr(case, name) for case in of_kind)) for name in names))
    return table
