"""The report of a commissioning: what was found with which versions and settings, as Markdown and as JSON."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from server.commissioning.contracts import Figure, ReportTable, StepResult, Verdict, still_counts
from server.errors import SettingsError

EXIT_PASS, EXIT_FAIL, EXIT_OPEN = 0, 1, 3
_REPORT_VERSION = 1


@dataclass(frozen=True, slots=True)
class Report:
    """One run of the check list. `earlier`: results taken over from a report that this run went on from."""

    machine: str
    started: str  # ISO 8601 with the offset from UTC
    longreach: str
    link: str  # version and layout
    cfg_id: int
    machine_sha256: str
    simulation: bool
    results: tuple[StepResult, ...]
    earlier: tuple[StepResult, ...]
    settings: dict[str, Any]
    open_answers: tuple[str, ...] = ()  # given in --answers, but never used
    complete: bool = False  # False: interrupted, or still under way
    version: int = _REPORT_VERSION

    @property
    def all_results(self) -> tuple[StepResult, ...]:
        """Those of this run, and the earlier ones that it did not repeat, or failures that it left open."""
        fresh = {result.name: result for result in self.results}
        open_ones = (old for old in self.earlier if old.name not in fresh or still_counts(old, fresh[old.name]))
        return (*self.results, *open_ones)


_ADAPTER = TypeAdapter(Report)


def exit_code(results: Sequence[StepResult]) -> int:
    """0: all pass; 1: something failed; 3: a step was skipped or inconclusive."""
    verdicts = {result.verdict for result in results}
    if Verdict.FAIL in verdicts:
        return EXIT_FAIL
    return EXIT_PASS if verdicts <= {Verdict.PASS} else EXIT_OPEN


def to_json(report: Report) -> str:
    """The report as JSON; what is not a number is null."""
    return _ADAPTER.dump_json(report, indent=1).decode()


def from_json(text: str, subject: str) -> Report:
    """The report that `to_json` wrote. Raises: SettingsError: it is not a report, or of another version."""
    try:
        report = _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise SettingsError(f"{subject} is not a report of this command: {where}: {first['msg']}") from error
    if report.version != _REPORT_VERSION:
        raise SettingsError(f"{subject}: report version {report.version}, this command reads {_REPORT_VERSION}")
    return report


def why_not_passed(report: Report, steps: Sequence[str], machine_sha256: str) -> str:
    """Why a report does not show that this machine is commissioned; empty when it does.

    Args: steps: names of all steps of the check list; machine_sha256: of the machine file in use.
    """
    if report.machine_sha256 != machine_sha256:
        return f"the report is of another machine file ({report.machine_sha256[:12]}, in use {machine_sha256[:12]})"
    if report.simulation:
        return "the report is of a simulated machine"
    passed = {result.name for result in report.all_results if result.verdict is Verdict.PASS}
    open_steps = [name for name in steps if name not in passed]
    if open_steps:
        return f"{len(open_steps)} of {len(steps)} steps have not passed: {', '.join(open_steps)}"
    return "" if report.complete else "the report was interrupted"


def to_markdown(report: Report) -> str:
    """The report for people: verdicts first, then every step with its figures."""
    rows = "\n".join(
        f"| {r.name} | {r.verdict.value} | {_escaped_cell(r.summary)} | {_escaped_cell(r.remedy)} |"
        for r in report.all_results
    )
    steps = "\n\n".join(_step_markdown(result, result not in report.results) for result in report.all_results)
    simulation = "**A simulated machine**, not a real one.\n\n" if report.simulation else ""
    unfinished = "" if report.complete else "**Not finished**: interrupted, or still under way.\n\n"
    left = ", ".join(report.open_answers)
    unasked = f"Answers without a question: {left}\n\n" if left else ""
    return (
        f"# Commissioning of {report.machine}\n\n{simulation}{unfinished}| | |\n|---|---|\n"
        f"| begun | {report.started} |\n| longreach | {report.longreach} |\n| link | {report.link} |\n"
        f"| cfg_id of the PLC | {report.cfg_id:#010x} |\n| machine file, SHA-256 | {report.machine_sha256} |\n\n"
        f"| step | verdict | found | to do |\n|---|---|---|---|\n{rows}\n\n{unasked}{steps}\n\n"
        f"## Settings\n\n{_settings_markdown(report.settings)}\n"
    )


def _step_markdown(result: StepResult, is_earlier: bool) -> str:
    head = f"## {result.name}: {result.verdict.value}" + (" (from the earlier report)" if is_earlier else "")
    parts = [head, result.summary, f"To do: {result.remedy}" if result.remedy else ""]
    if result.figures:
        parts.append(_figures_table(result.figures))
    parts += [_table_markdown(table) for table in result.tables]
    parts.append("\n".join(f"- {note}" for note in result.notes))
    return "\n\n".join(part for part in parts if part) + f"\n\nTook {result.duration_s:.0f} s."


def _figures_table(figures: Sequence[Figure]) -> str:
    rows = [
        f"| {_escaped_cell(f.name)} | {_number_text(f.value)} | {_limit_text(f)} | {f.unit} |"
        f" {'' if f.ok else '**no**'} |"
        for f in figures
    ]
    return "\n".join(["| figure | value | limit | unit | inside |", "|---|---|---|---|---|", *rows])


def _limit_text(figure: Figure) -> str:
    low = "" if figure.at_least is None else f">= {figure.at_least:.4g}"
    high = "" if figure.at_most is None else f"<= {figure.at_most:.4g}"
    return ", ".join(part for part in (low, high) if part)


def _number_text(value: float) -> str:
    return "none" if math.isnan(value) else f"{value:.4g}"


def _table_markdown(table: ReportTable) -> str:
    head = "| " + " | ".join(table.headings) + " |"
    rows = ["| " + " | ".join(_escaped_cell(text) for text in row) + " |" for row in table.rows]
    return "\n".join([f"{table.title}:\n", head, "|" + "---|" * len(table.headings), *rows])


def _escaped_cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _settings_markdown(settings: dict[str, Any], prefix: str = "") -> str:
    lines = []
    for name, value in settings.items():
        if isinstance(value, dict):
            lines.append(_settings_markdown(value, f"{prefix}{name}."))
        else:
            lines.append(f"- {prefix}{name} = {value!r}")
    return "\n".join(lines)
