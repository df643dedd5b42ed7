"""Probes of the motion gate between knots: the peaks of the quintic, against its shape written out another way."""

import random
from collections.abc import Iterator
from typing import Any

from gate_probes import (
    AXES,
    MS,
    RUNNING,
    SLEW,
    Probe,
    at,
    implied,
    limit_qd,
    passes,
    peak,
    refused,
    speeding,
    trajectory,
)

from protocol.messages import ZEROS, Command, Knot

HUMP_QD = 1.875  # of the mean: 30 s^2 (1 - s)^2 at s = 1/2
HUMP_QDD = 5.712890625  # of the mean over T: 60 s - 180 s^2 + 120 s^3 at s = 3/16, the highest of the fifteen


def hump(j: int, v: float, mean: float, dt_ms: int) -> tuple[Command, dict[str, Any]]:
    """The same speed at both ends and another one between."""
    after = Knot((50 + dt_ms) * MS, at(j, mean * dt_ms / 1e3), at(j, v))
    return trajectory((after,)), RUNNING | {"knot_before": Knot(50 * MS, ZEROS, at(j, v))}


def quintic_probes() -> Iterator[Probe]:
    """Peaks of the quintic at 1.05 of the limits, as far as the fifteen points see them."""
    for j, axis in AXES:
        for sign in (1.0, -1.0):
            v = 0.9 * axis.qd_max
            for share, inside in ((1.0 - 1e-6, True), (1.0 + 1e-6, False), (1.01, False)):
                top = 1.05 * axis.qd_max * share
                case = hump(j, sign * v, sign * (v + (top - v) / HUMP_QD), 200)
                name = f"{axis.name} {sign} quintic speed {share}"
                wrong = peak(axis, 50, 250, top, axis.qd_max, "rad/s")
                yield passes(name, *case) if inside else refused(name, *case, wrong)
                top = 1.05 * axis.qdd_max * share
                case = hump(j, 0.0, sign * top * 0.05 / HUMP_QDD, 50)
                name = f"{axis.name} {sign} quintic acceleration {share}"
                wrong = peak(axis, 50, 100, top, axis.qdd_max, "rad/s^2")
                yield passes(name, *case) if inside else refused(name, *case, wrong)


def shape(a: Knot, b: Knot, j: int, T: float, s: float) -> tuple[float, float]:
    """Speed and acceleration at s of the segment's time, by the Hermite basis of degree 5 written out."""
    way, wa, wb = b.q[j] - a.q[j], a.qdd[j], b.qdd[j]
    v = (1 - 18 * s**2 + 32 * s**3 - 15 * s**4, -12 * s**2 + 28 * s**3 - 15 * s**4)
    w = (s - 4.5 * s**2 + 6 * s**3 - 2.5 * s**4, 1.5 * s**2 - 4 * s**3 + 2.5 * s**4)
    d = 30 * s**2 - 60 * s**3 + 30 * s**4
    qd = way * d / T + a.qd[j] * v[0] + b.qd[j] * v[1] + T * (wa * w[0] + wb * w[1])
    v = (-36 * s + 96 * s**2 - 60 * s**3, -24 * s + 84 * s**2 - 60 * s**3)
    w = (1 - 9 * s + 18 * s**2 - 10 * s**3, 3 * s - 12 * s**2 + 10 * s**3)
    d = 60 * s - 180 * s**2 + 120 * s**3
    return qd, way * d / T / T + (a.qd[j] * v[0] + b.qd[j] * v[1]) / T + wa * w[0] + wb * w[1]


def peaks(a: Knot, b: Knot, j: int, T: float) -> tuple[tuple[float, int], tuple[float, int]]:
    """Largest |qd| and |qdd| of the fifteen points, and the sixteenth of the time where each is."""
    points = [(shape(a, b, j, T, i / 16), i) for i in range(1, 16)]
    return max((abs(p[0]), i) for p, i in points), max((abs(p[1]), i) for p, i in points)


def any_quintic(rng: random.Random, i: int) -> tuple[Probe, tuple[str, int]]:
    """A quintic of any shape, and where its refused peak is: speed or acceleration, and the point."""
    j, axis = AXES[i % 2]
    T_ms = rng.choice((8, 50, 100, 200))
    T = T_ms / 1e3
    before = Knot(50 * MS, ZEROS, at(j, rng.uniform(-1, 1) * axis.qd_max), at(j, rng.uniform(-1, 1) * axis.qdd_max))
    way, v1, a1 = rng.uniform(-1, 1) * axis.qd_max * T, rng.uniform(-1, 1), rng.uniform(-1, 1)
    after = Knot((50 + T_ms) * MS, at(j, way), at(j, v1 * axis.qd_max), at(j, a1 * axis.qdd_max))
    (qd, at_qd), (qdd, at_qdd) = peaks(before, after, j, T)
    case, name = (trajectory((after,)), RUNNING | {"knot_before": before}), f"quintic {i} of {axis.name}"
    if qd > 1.05 * axis.qd_max:
        return refused(name, *case, peak(axis, 50, 50 + T_ms, qd, axis.qd_max, "rad/s")), ("qd", at_qd)
    if qdd > 1.05 * axis.qdd_max:
        return refused(name, *case, peak(axis, 50, 50 + T_ms, qdd, axis.qdd_max, "rad/s^2")), ("qdd", at_qdd)
    return passes(name, *case), ("", 0)


def any_quintic_probes() -> Iterator[Probe]:
    """Quintics of all shapes: a hundred, and then as many as make each of the fifteen points the highest one."""
    rng = random.Random(5)
    seen: set[tuple[str, int]] = set()
    for i in range(6000):
        probe, where = any_quintic(rng, i)
        if i < 100 or where not in seen:
            yield probe
        seen.add(where)
    too_fast, view = speeding(0, 1.2 * SLEW.qd_max, 1.0)
    (qd, _), _ = peaks(view["knot_before"], too_fast.knots[0], 0, 0.005)
    mean = 1.2 * SLEW.qd_max - 0.5 * 0.005
    wrong = [limit_qd(SLEW, 55, 0.6), implied(SLEW, 50, 55, mean), peak(SLEW, 50, 55, qd, SLEW.qd_max, "rad/s")]
    yield refused("the ends count as knots, not as points between", too_fast, view, *wrong)
    assert {("qdd", i) for i in range(2, 15)} <= seen
    for mirrored, point in ((False, 1), (True, 15)):  # too rare for the dice
        before, after = edge_quintic(mirrored)
        _, (qdd, at_qdd) = peaks(before, after, 0, 0.05)
        assert at_qdd == point
        command, view = trajectory((after,)), RUNNING | {"knot_before": before}
        yield refused(f"peak at point {point}", command, view, peak(SLEW, 50, 100, qdd, SLEW.qdd_max, "rad/s^2"))


def edge_quintic(mirrored: bool) -> tuple[Knot, Knot]:
    """50 ms whose acceleration has its peak, 1.06 of the limit, next to the beginning; mirrored: next to the end."""
    T, c = 0.05, [SLEW.qdd_max * x for x in (0.98, 2.1, -13.8, 10.72)]
    ends = c[0], sum(c)
    way_v = T * sum(x / (k + 1) for k, x in enumerate(c))
    way = T * T * sum(x / ((k + 1) * (k + 2)) for k, x in enumerate(c))
    if not mirrored:
        return Knot(50 * MS, ZEROS, ZEROS, at(0, ends[0])), Knot(100 * MS, at(0, way), at(0, way_v), at(0, ends[1]))
    return Knot(50 * MS, ZEROS, at(0, -way_v), at(0, ends[1])), Knot(100 * MS, at(0, -way), ZEROS, at(0, ends[0]))
