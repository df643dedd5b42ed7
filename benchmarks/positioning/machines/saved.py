"""Runs many machines: every one saved as a JSON line, a second run resumes, worker processes if wanted."""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from benchmarks.positioning.machines.machine_run import MachineRun, run_machine
from benchmarks.positioning.machines.variants import ABLATIONS, DEFAULT
from benchmarks.reproduce.error_budget import SEEING, SOURCES
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.fine_machine import FineMachine
from benchmarks.reproduce.noise_model import fitted_noise
from benchmarks.saved_lines import add_line, open_to_add, whole_lines
from recording.spawn import SINGLE_THREAD_ENVIRONMENT
from server.settings import read_machine

CHANGES = {**SOURCES, **SEEING}
VARIANTS = {one.name: one for one in (DEFAULT, *ABLATIONS)}
Advance = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Order:
    """What is asked for: `again`: position once more with the calibration kept; `fine`: the fine plant."""

    preset: str
    variant: str = DEFAULT.name
    again: bool = False
    fine: bool = False
    machine: str = "hiab033"
    change: str = "as drawn"

    @property
    def file_name(self) -> str:
        """Of the lines of this order."""
        change = "" if self.change == "as drawn" else f"-{self.change}"
        name = f"{self.preset}-{self.variant}{'-fine' if self.fine else ''}{'-again' if self.again else ''}{change}"
        return "".join(c if c.isalnum() or c in "-+." else "_" for c in name) + ".jsonl"


def run_machines(
    order: Order, seeds: Sequence[int], folder: Path, workers: int = 1, advance: Advance = lambda done: None
) -> list[MachineRun]:
    """The runs of these seeds in their order: those on file read back, the rest run and saved."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / order.file_name
    found = {one.seed: one for one in read_runs(file) if one.seed in set(seeds)}
    advance(len(found))
    missing = [seed for seed in seeds if seed not in found]
    with open_to_add(file) as out:
        for run in _fresh(order, missing, workers):
            add_line(out, run.to_dict())
            found[run.seed] = run
            advance(1)
    return [found[seed] for seed in seeds]


def read_runs(file: Path) -> list[MachineRun]:
    """Whole lines of a file; a line cut off by a stop, or of another version, is run again."""
    return whole_lines(file, lambda text: MachineRun.from_dict(json.loads(text)))


def _fresh(order: Order, seeds: Iterable[int], workers: int) -> Iterator[MachineRun]:
    if workers <= 1:
        for seed in seeds:
            yield run_one(order, seed)
        return
    os.environ.update({**SINGLE_THREAD_ENVIRONMENT, **os.environ})  # read by the fresh children
    with ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn")) as pool:
        for done in as_completed([pool.submit(run_one, order, seed) for seed in seeds]):
            yield done.result()


def run_one(order: Order, seed: int) -> MachineRun:
    """One machine of an order."""
    machine, noise = read_machine(order.machine), fitted_noise()
    make = FineMachine if order.fine else QuasiStaticMachine
    change = CHANGES[order.change]
    return run_machine(machine, order.preset, seed, noise, VARIANTS[order.variant], order.again, make, change)
