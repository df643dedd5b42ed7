"""Difference of two shares on the same machines, with its interval."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Z_95 = 1.959964


@dataclass(frozen=True, slots=True)
class PairedChange:
    """Share of `other` less share of `default`, its 95 % interval, and on how many machines only one succeeded."""

    value: float
    low: float
    high: float
    only_default: int
    only_other: int
    n: int


def paired_change(default: Sequence[bool], other: Sequence[bool]) -> PairedChange:
    """Newcombe's interval for paired proportions (Wilson's limits, with the pairs' correlation).

    Raises:  ValueError: not as many, or none.
    Source:  Newcombe 1998, Statistics in Medicine 17, 2635, method 10.
    """
    first, second = np.asarray(other, dtype=bool), np.asarray(default, dtype=bool)
    n = len(first)
    if n == 0 or len(second) != n:
        raise ValueError(f"{n} and {len(second)} outcomes; give the same machines' for both, at least one")
    a, b = int((first & second).sum()), int((first & ~second).sum())
    c, d = int((~first & second).sum()), int((~first & ~second).sum())
    p1, p2 = (a + b) / n, (a + c) / n
    (l1, u1), (l2, u2) = _wilson(p1, n), _wilson(p2, n)
    phi = _correlation(a, b, c, d, n)
    delta = p1 - p2
    low = np.sqrt((p1 - l1) ** 2 - 2.0 * phi * (p1 - l1) * (u2 - p2) + (u2 - p2) ** 2)
    high = np.sqrt((u1 - p1) ** 2 - 2.0 * phi * (u1 - p1) * (p2 - l2) + (p2 - l2) ** 2)
    return PairedChange(delta, float(delta - low), float(delta + high), c, b, n)


def _wilson(p: float, n: int) -> tuple[float, float]:
    middle = (p + Z_95**2 / (2 * n)) / (1 + Z_95**2 / n)
    half = Z_95 * np.sqrt(p * (1 - p) / n + Z_95**2 / (4 * n * n)) / (1 + Z_95**2 / n)
    return float(middle - half), float(middle + half)


def _correlation(a: int, b: int, c: int, d: int, n: int) -> float:
    sides = float((a + b) * (c + d) * (a + c) * (b + d))
    if sides == 0.0:
        return 0.0
    excess = a * d - b * c
    corrected = max(excess - n / 2.0, 0.0) if excess > 0 else float(excess)
    return float(corrected / np.sqrt(sides))
