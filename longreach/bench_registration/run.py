"""Runs the registration trials: every case saved as one line, a second run resumes where the first stopped."""

import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from longreach.bench_registration.cases import KINDS, PATHS, draw_case
from longreach.bench_registration.methods import Trial, available_methods, try_method
from longreach.saved_lines import add_line, open_to_add, whole_lines

CHUNK = 25

Cell = tuple[str, str]
CELLS: tuple[Cell, ...] = tuple((kind, path) for kind in KINDS for path in PATHS)
#: Per seed, per method.
Trials = dict[int, dict[str, Trial]]


def run_trials(
    n: int, seed: int, folder: Path, workers: int, advance: Callable[[int], None] = lambda done: None
) -> dict[Cell, Trials]:
    """Trials `seed` to `seed + n - 1` of every cell, those on file read back, the rest run and saved."""
    folder.mkdir(parents=True, exist_ok=True)
    methods = available_methods()
    found = {cell: _on_file(_file(folder, cell), methods, range(seed, seed + n)) for cell in CELLS}
    advance(sum(len(trials) for trials in found.values()))
    jobs = []
    for start in range(seed, seed + n, CHUNK):  # all cells reach the same N, whenever it is stopped
        for cell in CELLS:
            missing = [one for one in range(start, min(start + CHUNK, seed + n)) if one not in found[cell]]
            jobs += [(cell, missing, methods)] if missing else []
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read by the fresh children: one thread each
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn")) as pool:
        for (cell, _, _), trials in zip(jobs, pool.map(_chunk, jobs), strict=True):
            found[cell] |= trials
            with open_to_add(_file(folder, cell)) as out:
                for one, by_method in trials.items():
                    methods_of = {name: asdict(trial) for name, trial in by_method.items()}
                    add_line(out, {"seed": one, "methods": methods_of})
            advance(len(trials))
    return found


def _chunk(job: tuple[Cell, list[int], list[str]]) -> Trials:
    (kind, path), seeds, methods = job
    return {one: {name: try_method(name, draw_case(path, kind, one)) for name in methods} for one in seeds}


def _file(folder: Path, cell: Cell) -> Path:
    return folder / f"{cell[0]} {cell[1]}.jsonl".replace(" ", "_")


def _on_file(file: Path, methods: list[str], seeds: range) -> Trials:
    """Whole lines that hold every method asked for; a line cut off by a stop is run again."""
    found: Trials = {}
    for line in whole_lines(file):
        if line["seed"] in seeds and all(name in line["methods"] for name in methods):
            found[line["seed"]] = {name: Trial(**line["methods"][name]) for name in methods}
    return found
