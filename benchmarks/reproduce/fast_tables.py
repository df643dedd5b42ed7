"""N machines of each table in the fast world, saved case by case."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

from rich.console import Console

from benchmarks.reproduce.cases import Case, State, line_case, matching_case
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.true_error import StepErrors, Three
from benchmarks.saved_lines import Line, run_saved
from machine.description import Machine
from server.jobs.plans.line import LineVariant

LINE_VARIANTS: tuple[LineVariant, ...] = (
    "paper servo",
    "fit",
    "fit, OOI axes",
)  # the servo's first move is the paper's
OOI_AXES_SHARE = 0.2  # of the machines: a variant beside the table
TABLE_4_FILE = "table4-matching.jsonl"


def table_2_file(variant: str) -> str:
    """Name of the file of a variant."""
    return f"table2-{variant.replace(',', '').replace(' ', '-')}.jsonl"


@dataclass(frozen=True, slots=True)
class TableCases:
    """Cases of one table, by kind."""

    by_kind: dict[str, list[Case]]


def table_2(machine: Machine, noise: NoiseModel, seeds: range, folder: Path, console: Console) -> TableCases:
    """The line equation: the paper's with its servo steps, our fit, and our fit in the OOI's axes."""
    found = {}
    for variant in LINE_VARIANTS:
        own = seeds[: max(1, round(OOI_AXES_SHARE * len(seeds)))] if variant == "fit, OOI axes" else seeds

        def run(seed: int, variant: LineVariant = variant) -> Line:
            return case_line(line_case(machine, seed, noise, variant))

        lines = run_saved(folder / table_2_file(variant), own, run, console, f"Table 2, {variant}")
        found[variant] = [case_of(line) for line in lines]
    return TableCases(found)


def table_4(machine: Machine, noise: NoiseModel, seeds: range, folder: Path, console: Console) -> TableCases:
    """The paper's trajectory matching with two inputs; Table 3 is in the notes of each case."""

    def run(seed: int) -> Line:
        return case_line(matching_case(machine, seed, noise))

    lines = run_saved(folder / TABLE_4_FILE, seeds, run, console, "Tables 3 and 4, matching")
    return TableCases({"matching": [case_of(line) for line in lines]})


def case_line(case: Case) -> Line:
    """A case as a JSON line."""
    return asdict(case)


def case_of(line: Line) -> Case:
    """A case of a saved line."""
    steps = tuple(_step(step) for step in line["steps"])
    start = cast("Three | None", None if line["start_mm"] is None else tuple(line["start_mm"]))
    state = cast(State, line["state"])
    return Case(line["seed"], line["kind"], state, line["reason"], steps, start, line["notes"])


def _step(step: dict[str, Any]) -> StepErrors:
    values: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in step.items()}
    return StepErrors(**values)
