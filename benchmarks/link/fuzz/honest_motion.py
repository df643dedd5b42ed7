"""Motions that a decent PC would ask for, and some just past the limits: quintics sampled as knots."""

import math
from collections.abc import Sequence
from random import Random

from protocol.limits import LimitTable
from protocol.messages import Knot, pad_to_eight_axes

_LOADS = (0.3, 0.7, 0.95, 0.999, 1.0, 1.02, 1.2)  # of the limits: the last ones break them
_STEPS_NS = (50_000_000, 50_000_000, 50_000_000, 20_000_000, 100_000_000, 200_000_000, 5_000_000)
_PEAK_SPEED, _PEAK_ACCELERATION = 1.875, 5.7735  # of a quintic from rest to rest over 1 in time 1
_MOST_KNOTS = 120
Row = tuple[float, float, float]  # q, qd, qdd of one axis


def _polynomial(start: Row, q_end: float, duration_s: float) -> tuple[float, ...]:
    """c0..c5 of the quintic in t from (q, qd, qdd) to rest at q_end."""
    q, v, a = start
    T = duration_s
    h, w, u = q_end - q - v * T - 0.5 * a * T * T, -v - a * T, -a
    c3 = (10.0 * h - 4.0 * w * T + 0.5 * u * T * T) / T**3
    c4 = (-15.0 * h + 7.0 * w * T - u * T * T) / T**4
    c5 = (6.0 * h - 3.0 * w * T + 0.5 * u * T * T) / T**5
    return q, v, 0.5 * a, c3, c4, c5


def _at(c: Sequence[float], t: float) -> Row:
    q = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
    qd = c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * (4.0 * c[4] + t * 5.0 * c[5])))
    return q, qd, 2.0 * c[2] + t * (6.0 * c[3] + t * (12.0 * c[4] + t * 20.0 * c[5]))


def sampled(before: Knot, q_end: Sequence[float], n_steps: int, step_ns: int) -> tuple[Knot, ...]:
    """Knots after `before`, a step apart, to rest at q_end."""
    rows = [(before.q[j], before.qd[j], before.qdd[j]) for j in range(len(q_end))]
    duration_s = n_steps * step_ns * 1e-9
    axes = [_polynomial(row, end, duration_s) for row, end in zip(rows, q_end, strict=True)]
    knots = []
    for i in range(1, n_steps + 1):
        points = [_at(c, i * step_ns * 1e-9) for c in axes]
        if i == n_steps:
            points = [(end, 0.0, 0.0) for end in q_end]
        q, qd, qdd = zip(*points, strict=True)
        knots.append(
            Knot(before.t_ns + i * step_ns, pad_to_eight_axes(q), pad_to_eight_axes(qd), pad_to_eight_axes(qdd))
        )
    return tuple(knots)


def trajectory(q_ref: Sequence[float], table: LimitTable, rng: Random) -> tuple[Knot, ...]:
    """From rest at q_ref to rest somewhere in the range, near the limits of speed or acceleration."""
    load, step_ns = rng.choice(_LOADS), rng.choice(_STEPS_NS)
    q_end, duration_s = [], step_ns * 1e-9
    for axis, here in zip(table.axes, q_ref, strict=False):
        q = min(max(here, axis.q_min), axis.q_max)  # a mutated state may tell of any place
        way = rng.uniform(-1.0, 1.0) * rng.choice((0.0, 0.02, 0.2, 0.6))
        end = min(max(q + way, axis.q_min), axis.q_max)
        q_end.append(end)
        speed_s = _PEAK_SPEED * abs(end - q) / (load * axis.qd_max)
        acceleration_s = math.sqrt(_PEAK_ACCELERATION * abs(end - q) / (load * axis.qdd_max))
        duration_s = max(duration_s, speed_s, acceleration_s)
    n_steps = min(max(math.ceil(duration_s * 1e9 / step_ns), 1), _MOST_KNOTS)
    first = Knot(0, pad_to_eight_axes(tuple(q_ref[: len(q_end)])))
    return (first, *sampled(first, q_end, n_steps, step_ns))


def tail(knots: Sequence[Knot], first: int, n_axes: int, rng: Random) -> tuple[Knot, ...]:
    """Other knots from index `first` on, spliced to the one before."""
    before = knots[first - 1]
    q_end = [q + rng.uniform(-0.02, 0.02) for q in knots[-1].q[:n_axes]]
    n_steps = max(len(knots) - first + rng.randint(-2, 4), 1)
    step_ns = knots[first].t_ns - before.t_ns
    return (*knots[:first], *sampled(before, q_end, n_steps, max(step_ns, 1)))
