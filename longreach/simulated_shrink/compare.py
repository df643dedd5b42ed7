"""Measured less simulated: RMS before and after by column, the repeats' own floor, and the share that is closed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine.rotations import Array

BLOCK_S = 0.05
SKIPPED_S = 1.0  # at a stretch's start: what the valve was doing there is not known


@dataclass(frozen=True, slots=True)
class Errors:
    """Measured less simulated of one stretch, (m, columns), before and after. `repeats`: of which command it is a whole
    repeat, or "".
    """

    before: Array
    after: Array
    repeats: str


@dataclass(frozen=True, slots=True)
class Closed:
    """RMS of one column or of all: before, after, floor (None without repeats), and the closed share."""

    before: float
    after: float
    floor: float | None
    closed_frac: float | None


def positions(measured: Array, simulated: Array, dt_s: float) -> Array:
    """Errors of positions (m, n), the start left out."""
    return (measured - simulated)[round(SKIPPED_S / dt_s) :]


def speeds(measured: Array, simulated: Array, dt_s: float) -> Array:
    """Errors of speeds (m, n) [1/s], by 20 Hz block means: open loop, a position's error is a random walk."""
    size = max(1, round(BLOCK_S / dt_s))
    error = positions(measured, simulated, dt_s)
    rows = len(error) // size * size
    means = error[:rows].reshape(-1, size, error.shape[1]).mean(axis=1)
    return np.diff(means, axis=0) / (size * dt_s)


def closed(errors: Sequence[Errors], column: int | None = None) -> Closed:
    """Of one column, or of all together.

    Model: 1 - (after^2 - floor^2) / (before^2 - floor^2), never clipped; None where the gap before is within the floor.
    """
    pick = slice(None) if column is None else slice(column, column + 1)
    before, after = (_mean_square([getattr(error, name)[:, pick] for error in errors]) for name in ("before", "after"))
    floor = floor_square(errors, pick)
    quiet = floor or 0.0
    share = 1.0 - (after - quiet) / (before - quiet) if before > 1.1 * quiet and before > 0.0 else None
    return Closed(float(before**0.5), float(after**0.5), None if floor is None else float(floor**0.5), share)


def floor_square(errors: Sequence[Errors], pick: slice) -> float | None:
    """Mean square of what repeats of one command differ by from their mean, times R / (R - 1); None without repeats."""
    groups: dict[str, list[Array]] = {}
    for error in errors:
        if error.repeats:
            groups.setdefault(error.repeats, []).append(error.after[:, pick])
    squares = []
    for members in groups.values():
        if len(members) < 2:
            continue
        rows = min(len(member) for member in members)
        stack = np.stack([member[:rows] for member in members])
        squares.append((stack - stack.mean(axis=0)) ** 2 * len(members) / (len(members) - 1))
    return None if not squares else float(np.mean(np.concatenate([square.ravel() for square in squares])))


def _mean_square(parts: Sequence[Array]) -> float:
    return float(np.mean(np.concatenate([part.ravel() for part in parts]) ** 2))
