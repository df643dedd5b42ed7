"""One line of the camera check: what was looked at, how it is, and what to do. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum


class Level(Enum):
    """How one thing stands."""

    OK = "OK"
    WARN = "WARN"
    FAIL = "FAIL"


@dataclass(frozen=True, slots=True)
class CheckFinding:
    """One line. `name` is stable for machines; `figures` by name, units in the names; `remedy` is empty when OK."""

    name: str
    level: Level
    text: str
    remedy: str = ""
    figures: dict[str, float] = field(default_factory=dict)


def level_by_limits(value: float, warn_from: float, fail_from: float) -> Level:
    """FAIL from one limit on, WARN from the other."""
    return Level.FAIL if value >= fail_from else Level.WARN if value >= warn_from else Level.OK


def worst_level(findings: Sequence[CheckFinding]) -> Level:
    """FAIL before WARN before OK."""
    levels = {finding.level for finding in findings}
    return Level.FAIL if Level.FAIL in levels else Level.WARN if Level.WARN in levels else Level.OK


def exit_code(findings: Sequence[CheckFinding]) -> int:
    """1 when anything failed, else 0."""
    return 1 if worst_level(findings) is Level.FAIL else 0
