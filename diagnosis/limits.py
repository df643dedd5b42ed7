"""How sure a fitted number is, and how small an effect this recording could have shown."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.cells import Cell
from diagnosis.fit import Fit, bounds, costs, evaluated
from diagnosis.score import covariance
from diagnosis.search import Scan
from machine.rotations import Array

SHOWN_ENERGY = 43.0  # |s|^2 with s/2 - 1.28 = 2 standard errors over blocks (score.py): found with 90 %
CHANCE_90 = 1.35  # nats below the best: 90 % limits of one number
FLAT_NATS = 1e-3
WIDEST = 0.1  # of the range: how far from the fit limits are looked for
OFFSETS = np.concatenate([-np.geomspace(30.0, 0.3, 8), np.geomspace(0.3, 30.0, 8)])  # in standard deviations


@dataclass(frozen=True, slots=True)
class Interval:
    """A fitted number with 90 % limits."""

    value: float
    low: float
    high: float


def intervals(cell: Cell, found: Fit, spread: float) -> tuple[Interval, ...]:
    """Limits of each number (the others held), by the cost's own course: flat valleys and kinks are seen.

    Model: cost / spread rises by 1.35 nats; tried out to 30 standard deviations, and to 10 % of the range.
    """
    if found.k == 0:
        return ()
    low, high = bounds(found.hypothesis)
    sd = np.sqrt(np.maximum(np.diag(covariance(found)), 0.0) * spread)
    return tuple(
        _interval(cell, found, k, float(sd[k]), (float(low[k]), float(high[k])), spread) for k in range(found.k)
    )


def _interval(cell: Cell, found: Fit, k: int, sd: float, limits: tuple[float, float], spread: float) -> Interval:
    value, (low, high) = float(found.theta[k]), limits
    widest = WIDEST * (high - low)
    local = np.concatenate([[0.0], OFFSETS * min(sd, widest), OFFSETS * widest / OFFSETS[-1]])
    tried = np.unique(np.clip(value + local, low, high))
    thetas = np.tile(found.theta, (len(tried), 1))
    thetas[:, k] = tried
    rise = (costs(evaluated(cell, found.hypothesis, thetas)).sum(axis=1) - found.cost) / spread
    at = int(np.searchsorted(tried, value))
    flat = tried[_run(np.abs(rise) < FLAT_NATS, at)]
    if len(flat) > 2:  # nothing between them can be told apart: the middle stands for all
        value = 0.5 * (float(flat[0]) + float(flat[-1]))
    inside = _run(rise < CHANCE_90, at)
    return Interval(value, _crossing(tried, rise, inside.start, -1), _crossing(tried, rise, inside.stop - 1, 1))


def _run(mask: NDArray[np.bool_], at: int) -> slice:
    """The unbroken run of True around `at`, which counts as True."""
    first = last = at
    while first > 0 and mask[first - 1]:
        first -= 1
    while last < len(mask) - 1 and mask[last + 1]:
        last += 1
    return slice(first, last + 1)


def _crossing(tried: Array, rise: Array, edge: int, side: int) -> float:
    """Where the cost crosses the limit between the last size inside and the next one."""
    following = edge + side
    if not 0 <= following < len(tried):
        return float(tried[edge])
    span = rise[following] - rise[edge]
    share = (CHANCE_90 - rise[edge]) / span if span > 0.0 else 1.0
    return float(tried[edge] + np.clip(share, 0.0, 1.0) * (tried[following] - tried[edge]))


@dataclass(frozen=True, slots=True)
class Limit:
    """The smallest size of an effect that a recording could have shown; None: none within its bounds."""

    name: str
    joint: int | None
    parameter: str
    size: float | None


def detection_limit(one: Scan, spread: float, usual_nats: float = 0.0) -> Limit:
    """By the change of the residual at the scanned sizes, between them on a straight line of the logarithms."""
    slot = one.candidate.slots[0]
    neutral_zero = slot.neutral == 0.0
    sizes = np.abs(one.thetas).max(axis=1) if one.candidate.vector else np.abs(one.thetas[:, 0])
    strength = np.sqrt(np.maximum(one.energy / spread, 1e-30))
    wanted = np.sqrt(SHOWN_ENERGY + 2.0 * usual_nats / spread)
    levels = np.unique(sizes)[:: 1 if neutral_zero else -1]
    weakest = np.array([strength[sizes == level].min() for level in levels])
    above = np.nonzero(weakest >= wanted)[0]
    name, joint, parameter = one.candidate.name, one.candidate.joint, slot.parameter
    if len(above) == 0:
        return Limit(name, joint, parameter, None)
    at = int(above[0])
    if at == 0:
        smaller = levels[0] * wanted / weakest[0] if neutral_zero else levels[0]
        return Limit(name, joint, parameter, float(smaller))
    x, y = np.log(levels[at - 1 : at + 1]), np.log(weakest[at - 1 : at + 1])
    share = (np.log(wanted) - y[0]) / (y[1] - y[0])
    return Limit(name, joint, parameter, float(np.exp(x[0] + share * (x[1] - x[0]))))
