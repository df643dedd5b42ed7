"""How sure a fitted number is, and how small an effect this recording could have shown."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, bounds, costs, evaluated, spans, weights
from diagnosis.search.scan import Scan
from diagnosis.search.score import covariance
from machine.rotations import Array

WHITE_ENERGY = 43.0  # |s|^2 with s/2 - 1.28 = 2 standard errors over blocks (score.py): in white noise found with 90 %
SCATTER = 1.3  # of a gain over white noise's: numbers wander by the day (22 of 25 found at the limit; 11 of 16 by 1)
SHOWN_ENERGY = SCATTER**2 * WHITE_ENERGY
QUANTILE_95 = 1.645  # of a normal: 5 % on either side
CHANCE_90 = 1.35  # nats below the best: 90 % limits of one number
FLAT_NATS = 1e-3
NEAR = 0.1  # of the range: within it limits are looked for more closely
FAR = 30.0  # standard deviations
REFITS = 2
AT_ONCE = 6  # sizes to either side, twice as many each further time
WAIT_90 = 0.68  # of a PLC cycle: the difference of two waits for the next one, with this delay and the nominal one
WAITED = 1.0  # of a PLC cycle: datagrams sent when a cycle begins wait for the next one after any part of one
OFFSETS = np.concatenate([-np.geomspace(FAR, 0.3, 8), np.geomspace(0.3, FAR, 8)])  # in standard deviations


@dataclass(frozen=True, slots=True)
class Interval:
    """A fitted number with 90 % limits."""

    value: float
    low: float
    high: float


def intervals(cell: Cell, found: Fit, spread: float, gained_nats: float = 0.0) -> tuple[Interval, ...]:
    """Limits of each number, by the cost's own course: flat valleys and kinks are seen.

    Model: cost / spread rises by 1.35 nats, the other numbers fitted again by two steps at each size: a gain and a
           frequency that trade off lie along a curve. Tried out to the ends of the range.
           With the others held it is as much narrower as the number's standard deviation is: the wider of the two.
           Beside a baseline that left something, the form of a name may be wrong by a share of all it gains, and so may
           its size; so it may where an effect's definition leaves some of it open. A counted share has chance's limits.
           A delay is known to the wait for the PLC's next cycle, and with clocks that run apart to what it is at the
           other end of the recording.
    """
    if found.k == 0:
        return ()
    low, high = bounds(found.hypothesis)
    variances = np.maximum(np.diag(covariance(found)), 0.0)
    alone = 1.0 / ((found.J**2 * weights(found.residual)[:, None]).sum(axis=0) + 1.0 / spans(found.hypothesis) ** 2)
    wider = np.sqrt(np.maximum(variances / alone, 1.0))
    form_share = cell.form_share if cell.left_share > 0.0 else 0.0
    allowed = CHANCE_90 + form_share * max(gained_nats, 0.0) / spread
    owners = [one for one in found.hypothesis for _ in one.slots]
    left_open = [slot.spec.open_frac for one in found.hypothesis for slot in one.slots]
    out = []
    for k, owner in enumerate(owners):
        if owner.counted:
            out.append(_of_share(float(found.theta[k]), owner.counted))
            continue
        held, free = _intervals(cell, found, k, float(np.sqrt(variances[k] * spread)), allowed, spread)
        below = max(float(wider[k]) * (held.value - held.low), free.value - free.low, left_open[k] * abs(held.value))
        above = max(float(wider[k]) * (held.high - held.value), free.high - free.value, left_open[k] * abs(held.value))
        if owner.cycles is not None:
            cycle_s = owner.cycles[0]
            below, above = below + WAITED * cycle_s, max(above, WAIT_90 * cycle_s)
            below, above = (below, above + owner.drift_s) if held.value > 0.0 else (below + owner.drift_s, above)
        out.append(
            Interval(held.value, max(float(low[k]), held.value - below), min(float(high[k]), held.value + above))
        )
    return tuple(out)


def _of_share(share: float, count: int) -> Interval:
    """Wilson's limits of a share seen among so many."""
    z2 = QUANTILE_95**2 / count
    centre = (share + 0.5 * z2) / (1.0 + z2)
    half = np.sqrt(z2 * (share * (1.0 - share) + 0.25 * z2)) / (1.0 + z2)
    return Interval(share, float(centre - half), float(centre + half))


def _intervals(cell: Cell, found: Fit, k: int, sd: float, allowed: float, spread: float) -> tuple[Interval, Interval]:
    """Limits of number k where cost / spread rises by what is allowed [nats]: the others held, and fitted again."""
    low, high = (float(edge[k]) for edge in bounds(found.hypothesis))
    value, whole = float(found.theta[k]), float(spans(found.hypothesis)[k])
    widest = NEAR * whole
    local = np.concatenate([[0.0], *(OFFSETS * one for one in (min(sd, widest), widest / FAR, whole / FAR))])
    tried = np.unique(np.clip(value + local, low, high))
    thetas = np.tile(found.theta, (len(tried), 1))
    thetas[:, k] = tried
    at = int(np.searchsorted(tried, value))
    rise, free = ((one - found.cost) / spread for one in _costs(cell, found, k, thetas, at, allowed * spread))
    flat = tried[_run(np.abs(rise) < FLAT_NATS, at)]
    if len(flat) > 2:  # nothing between them can be told apart: the middle stands for all
        value = 0.5 * (float(flat[0]) + float(flat[-1]))
    return _within(value, tried, rise, at, allowed), _within(value, tried, free, at, allowed)


def _costs(cell: Cell, found: Fit, k: int, thetas: Array, at: int, allowed: float) -> tuple[Array, Array]:
    """Cost (m,) at each of the sets `thetas` (m, k), the other numbers held, and fitted again too.

    Outwards from `at` until one to either side costs more than is allowed; beyond, where no limit lies, infinite.
    """
    held, free = np.full((2, len(thetas)), np.inf)
    first, end, width = at, at + 1, AT_ONCE
    new = np.array([at])
    while len(new) > 0:
        residuals = evaluated(cell, found.hypothesis, thetas[new])
        held[new] = free[new] = costs(residuals).sum(axis=1)
        if found.k > 1:
            free[new] = np.minimum(held[new], _refitted(cell, found, k, thetas[new], residuals))
        passed = free >= found.cost + allowed
        below = first if passed[first:at].any() else max(0, first - width)
        above = end if passed[at + 1 : end].any() else min(len(thetas), end + width)
        new = np.concatenate([np.arange(below, first), np.arange(end, above)])
        first, end, width = below, above, 2 * width
    return held, free


def _within(value: float, tried: Array, rise: Array, at: int, allowed: float) -> Interval:
    inside = _run(rise < allowed, at)
    first, last = inside.start, inside.stop - 1
    return Interval(value, _crossing(tried, rise, first, -1, allowed), _crossing(tried, rise, last, 1, allowed))


def _refitted(cell: Cell, found: Fit, k: int, thetas: Array, residuals: Array) -> Array:
    """Least cost (m,) of the sets `thetas` (m, k) with residuals (m, N), all numbers but the k-th moved by the steps
    that found's own Jacobian says.
    """
    others = np.arange(found.k) != k
    low, high = bounds(found.hypothesis)
    J, w = found.J[:, others], weights(found.residual)[:, None]
    H = (J * w).T @ J + np.diag(1.0 / spans(found.hypothesis)[others] ** 2)
    back = np.linalg.pinv(H) @ (J * w).T
    least = costs(residuals).sum(axis=1)
    for _ in range(REFITS):
        thetas = thetas.copy()
        thetas[:, others] -= residuals @ back.T - found.residual @ back.T
        thetas = np.clip(thetas, low, high)
        residuals = evaluated(cell, found.hypothesis, thetas)
        least = np.minimum(least, costs(residuals).sum(axis=1))
    return least


def _run(mask: NDArray[np.bool_], at: int) -> slice:
    """The unbroken run of True around `at`, which counts as True."""
    first = last = at
    while first > 0 and mask[first - 1]:
        first -= 1
    while last < len(mask) - 1 and mask[last + 1]:
        last += 1
    return slice(first, last + 1)


def _crossing(tried: Array, rise: Array, edge: int, side: int, allowed: float) -> float:
    """Where the cost crosses the limit between the last size inside and the next one: its root goes on a line there."""
    following = edge + side
    if not 0 <= following < len(tried):
        return float(tried[edge])
    inner, outer = np.sqrt(max(float(rise[edge]), 0.0)), np.sqrt(max(float(rise[following]), 0.0))
    share = (np.sqrt(allowed) - inner) / (outer - inner) if outer > inner else 1.0
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
