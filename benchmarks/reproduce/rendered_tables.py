"""N machines of each table end to end, saved case by case; the kinds take turns, so that all are there early."""

from pathlib import Path

from rich.console import Console

from benchmarks.reproduce.cases import Case
from benchmarks.reproduce.fast_tables import case_line, case_of
from benchmarks.reproduce.rendered_cases import rendered_line_case, rendered_matching_case
from benchmarks.saved_lines import Line, read_lines, run_saved
from machine.description import Machine
from server.jobs.plans.line import LineVariant

VARIANTS: dict[str, LineVariant] = {"line, paper servo": "paper servo", "line, fit": "fit"}
TABLE_2_KINDS = tuple(VARIANTS)
TABLE_4_KINDS = ("matching, paper",)
FILE = "rendered.jsonl"


def rendered_tables(machine: Machine, kinds: tuple[str, ...], seeds: range, folder: Path, console: Console) -> None:
    """Run or resume; the truth, logs and recordings of each case stay in a folder of its own."""

    def run(key: str) -> Line:
        kind, seed = key.rsplit(" ", 1)
        if kind in VARIANTS:
            return case_line(rendered_line_case(machine, int(seed), VARIANTS[kind], folder))
        return case_line(rendered_matching_case(machine, int(seed), folder))

    keys = [f"{kind} {seed}" for seed in seeds for kind in kinds]
    run_saved(folder / FILE, keys, run, console, "rendered, end to end")


def saved_rendered(folder: Path) -> dict[str, list[Case]]:
    """What is there, by kind as in `fast_tables`."""
    found: dict[str, list[Case]] = {"paper servo": [], "fit": [], "matching": []}
    for line in read_lines(folder / FILE).values():
        case = case_of(line)
        found["matching" if case.kind.startswith("matching") else case.kind.removeprefix("line, ")].append(case)
    return found
