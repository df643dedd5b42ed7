"""Signals found in a log of another system, before they are put on one time axis."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from machine.rotations import Array

Kind = Literal["position", "reference", "velocity_reference", "command"]
Use = Literal["used", "ignored"]


@dataclass(frozen=True, slots=True)
class JointSignal:
    """Numbers of joints over time: t_s (m,) [s], values (m, n) [rad or m, per s for velocities]; NaN where missing.

    `hold_last_value`: a value counts until the next one comes (a command); else it lies on a line between its
    neighbours.
    """

    kind: Kind
    source: str
    joint_names: tuple[str, ...]
    t_s: Array
    values: Array
    hold_last_value: bool = False


@dataclass(frozen=True, slots=True)
class TrackedPointSeries:
    """Places of one tracked point: t_s (m,) [s], xyz (m, 3) [m] in the tracker's frame."""

    name: str
    source: str
    t_s: Array
    xyz_m: Array


@dataclass(frozen=True, slots=True)
class SourceEntry:
    """One line of the list that the user sees: a topic or a column, and what became of it.

    `is_guess`: it was taken for this by its name or its size; the user has to confirm it.
    """

    name: str
    kind: str
    n_values: int
    use: Use
    reason: str
    is_guess: bool = False


@dataclass(slots=True)
class SourceContents:
    """All that was found. `notes`: remarks on the file as a whole. `truncated`: not all of the file could be read.

    `joints_numbered`: they are called joint1, joint2 ... by their place; `proposed_mapping_toml`: the guesses of a bag.
    """

    signals: list[JointSignal] = field(default_factory=list)
    tracked_points: list[TrackedPointSeries] = field(default_factory=list)
    entries: list[SourceEntry] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    started_s: float = 0.0
    command_kind: str = ""
    truncated: bool = False
    joints_numbered: bool = False
    proposed_mapping_toml: str = ""

    @property
    def guessed_entries(self) -> list[SourceEntry]:
        """What the user has to confirm."""
        return [entry for entry in self.entries if entry.is_guess and entry.use == "used"]

    def signals_of(self, kind: Kind) -> list[JointSignal]:
        """The signals of one kind."""
        return [signal for signal in self.signals if signal.kind == kind]


def in_time_order(t_s: Array, values: Array) -> tuple[Array, Array]:
    """Rows sorted by time; of rows with the same time the first one."""
    _, first = np.unique(t_s, return_index=True)
    return t_s[first], values[first]
