"""What a step of the check list gets and what it gives back: frozen results with figures, limits and a remedy."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Protocol

from pydantic import BeforeValidator


class Verdict(Enum):
    """How a step ended. Only PASS is a yes."""

    PASS = "pass"
    FAIL = "fail"
    SKIPPED = "skipped"  # no person answered, or gave permission
    INCONCLUSIVE = "inconclusive"  # something that the step needs was missing

    @classmethod
    def _missing_(cls, value: object) -> "Verdict | None":
        return cls.INCONCLUSIVE if value in ("cannot show", "cannot tell") else None  # old name, in earlier reports


def _number_or_nan(value: object) -> object:
    """JSON has no NaN: it is written as null."""
    return math.nan if value is None else value


Measured = Annotated[float, BeforeValidator(_number_or_nan)]


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured figure with its unit and its limits; without limits it is only reported."""

    name: str
    value: Measured
    unit: str
    at_least: float | None = None
    at_most: float | None = None

    @property
    def ok(self) -> bool:
        """Whether it is inside its limits; NaN never is inside one."""
        low = self.at_least is None or self.value >= self.at_least
        high = self.at_most is None or self.value <= self.at_most
        return low and high

    @property
    def as_line(self) -> str:
        """Name, value, limit and unit in one line."""
        low = "" if self.at_least is None else f"at least {self.at_least:g}"
        high = "" if self.at_most is None else f"at most {self.at_most:g}"
        limits = " and ".join(part for part in (low, high) if part)
        return f"{self.name} {self.value:.4g} {self.unit}" + (f" ({limits})" if limits else "")


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Rows for the report, already as text."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class StepResult:
    """What one step found. `remedy` says what to do unless the verdict is PASS."""

    name: str
    verdict: Verdict
    summary: str
    figures: tuple[Figure, ...] = ()
    remedy: str = ""
    notes: tuple[str, ...] = ()
    tables: tuple[ReportTable, ...] = ()
    duration_s: float = 0.0


def result_of_figures(
    name: str,
    figures: Iterable[Figure],
    summary: str,
    remedy: str,
    open_points: Iterable[str] = (),
    notes: Iterable[str] = (),
    tables: Iterable[ReportTable] = (),
) -> StepResult:
    """A result by its figures: one outside its limits fails; otherwise an open point makes it inconclusive.

    Args:    summary: what is right when nothing is wrong; remedy: for a figure outside its limits.
    """
    all_figures, missing = tuple(figures), tuple(open_points)
    wrong = [figure.as_line for figure in all_figures if not figure.ok]
    verdict = Verdict.FAIL if wrong else Verdict.INCONCLUSIVE if missing else Verdict.PASS
    found = "; ".join(wrong) if wrong else "; ".join(missing) if missing else summary
    return StepResult(
        name=name,
        verdict=verdict,
        summary=found,
        figures=all_figures,
        remedy=remedy
        if wrong
        else ""
        if verdict is Verdict.PASS
        else "provide what was missing and run this step again",
        notes=(*notes, *(missing if wrong else ())),
        tables=tuple(tables),
    )


def inconclusive_result(name: str, why: str, remedy: str) -> StepResult:
    """Something that the step needs is missing."""
    return StepResult(name, Verdict.INCONCLUSIVE, why, remedy=remedy)


def skipped_result(name: str, why: str, remedy: str) -> StepResult:
    """No person answered, or gave permission."""
    return StepResult(name, Verdict.SKIPPED, why, remedy=remedy)


def still_counts(earlier: StepResult, later: StepResult) -> bool:
    """Whether an earlier result of a step still counts: a failure does until the step is gone through to its end."""
    return earlier.verdict is Verdict.FAIL and later.verdict not in (Verdict.PASS, Verdict.FAIL)


class Operator(Protocol):
    """The engineer at the machine, a file of answers, or no person at all."""

    async def may_move(self, machine_name: str) -> bool:
        """Whether the machine may be moved at all; asked once."""
        ...

    async def confirm(self, text: str) -> bool:
        """Whether to go on with what is announced."""
        ...

    async def ask(self, key: str, question: str) -> str | None:
        """What a person saw; None without a person to answer."""
        ...

    def show(self, text: str) -> None:
        """Show a line."""
        ...

    def progress(self, text: str, current: float, target: float, unit: str) -> None:
        """Show how far something that takes longer has come."""
        ...
