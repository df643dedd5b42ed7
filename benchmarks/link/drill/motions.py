"""Motions for the drills: rest to rest, close to the joints' limits, with every joint on a time of its own."""

import random

from protocol.limits import LimitTable
from protocol.messages import Axes, Knot, pad_to_eight_axes

_PEAK_SPEED = 1.875  # of the quintic from rest to rest, times distance / duration
_PEAK_ACCELERATION = 5.7735026919  # times distance / duration^2
_MS_NS = 1_000_000
_SPACINGS_MS = (5, 10, 20, 40, 50, 50, 50, 60, 100)


def quintic(u: float) -> tuple[float, float, float]:
    """Share of the way, and its first two derivatives, at u = t / T; rest outside 0..1."""
    if u <= 0.0:
        return 0.0, 0.0, 0.0
    if u >= 1.0:
        return 1.0, 0.0, 0.0
    return (
        u * u * u * (10.0 - u * (15.0 - 6.0 * u)),
        30.0 * u * u * (1.0 - u) * (1.0 - u),
        60.0 * u * (1.0 - u * (3.0 - 2.0 * u)),
    )


def knots_between(q0: Axes, q1: Axes, windows_ms: tuple[tuple[float, float], ...], times_ms: list[int]) -> list[Knot]:
    """Every joint from q0 to q1 by a quintic within its window (from, until); the rest of the time it rests."""
    knots = []
    for t_ms in times_ms:
        q, qd, qdd = [], [], []
        for a, b, (start, end) in zip(q0, q1, windows_ms, strict=False):
            T_s = (end - start) * 1e-3
            p, v, acc = quintic((t_ms - start) / (end - start))
            q.append(a + (b - a) * p if p < 1.0 else b)
            qd.append((b - a) * v / T_s)
            qdd.append((b - a) * acc / (T_s * T_s))
        knots.append(
            Knot(
                t_ms * _MS_NS, pad_to_eight_axes(tuple(q)), pad_to_eight_axes(tuple(qd)), pad_to_eight_axes(tuple(qdd))
            )
        )
    return knots


def reach(table: LimitTable, j: int, duration_s: float) -> float:
    """How far joint j gets in duration_s at its limits [rad]."""
    axis = table.axes[j]
    return min(axis.qd_max * duration_s / _PEAK_SPEED, axis.qdd_max * duration_s**2 / _PEAK_ACCELERATION)


def draw_motion(table: LimitTable, q0: Axes, rng: random.Random) -> tuple[Knot, ...]:
    """A motion of 0.3 to 2 s from q0, at rest; one joint close to its limits, knots evenly spaced or not."""
    spacing_ms = rng.choice(_SPACINGS_MS)
    n = max(round(rng.uniform(300, 2000) / spacing_ms), 2)
    times_ms = [i * spacing_ms for i in range(n + 1)]
    if spacing_ms >= 40 and rng.random() < 0.3:
        times_ms = [t + (rng.randint(-15, 15) if 0 < t < times_ms[-1] else 0) for t in times_ms]
    total_ms, share = times_ms[-1], rng.choice((0.3, 0.8, 0.97, 0.999))
    leading = rng.randrange(len(table.axes))
    targets, windows = [], []
    for j, axis in enumerate(table.axes):
        start_ms, end_ms = _window(times_ms, rng) if rng.random() < 0.5 else (0, total_ms)
        size = share * (1.0 if j == leading else rng.random()) * reach(table, j, (end_ms - start_ms) * 1e-3)
        room_up, room_down = max(axis.q_max - q0[j], 0.0), max(q0[j] - axis.q_min, 0.0)
        up = rng.random() < 0.5 if min(room_up, room_down) > size else room_up > room_down
        targets.append(q0[j] + min(size, room_up) if up else q0[j] - min(size, room_down))
        windows.append((float(start_ms), float(end_ms)))
    return tuple(knots_between(q0, pad_to_eight_axes(tuple(targets)), tuple(windows), times_ms))


def _window(times_ms: list[int], rng: random.Random) -> tuple[int, int]:
    """Two knot times: a joint that starts or ends between knots would not be met by the quintics."""
    a, b = sorted((rng.randrange(len(times_ms)), rng.randrange(len(times_ms))))
    return (times_ms[a], times_ms[b]) if a < b else (times_ms[0], times_ms[-1])


def roughen(table: LimitTable, knots: tuple[Knot, ...], rng: random.Random) -> tuple[Knot, ...]:
    """The same motion by somebody who plans less well: accelerations off by a little, so that the quintics overshoot.

    They stay inside the limits at the knots; between them the gate may refuse it.
    """
    size = rng.choice((0.01, 0.05, 0.15))
    rough = list(knots)
    for k in range(1, len(knots) - 1):
        qdd = list(knots[k].qdd)
        for j, axis in enumerate(table.axes):
            off = rng.uniform(-size, size) * axis.qdd_max
            qdd[j] = min(max(qdd[j] + off, -axis.qdd_max), axis.qdd_max)
        rough[k] = Knot(knots[k].t_ns, knots[k].q, knots[k].qd, pad_to_eight_axes(tuple(qdd[: len(table.axes)])))
    return tuple(rough)


def draw_tail(
    table: LimitTable, knots: tuple[Knot, ...], not_before_ns: int, rng: random.Random
) -> tuple[int, tuple[Knot, ...]]:
    """Index and knots of a new tail that begins at not_before_ns or later; no knots: it is too late for one.

    From the knot before, every joint goes to rest by a quintic that begins with its speed and acceleration there.
    """
    first = next((i for i, knot in enumerate(knots) if i > 0 and knot.t_ns >= not_before_ns), None)
    if first is None:
        return 0, ()
    splice, n = knots[first - 1], len(table.axes)
    spacing_ns = 50 * _MS_NS
    count = rng.randint(6, 30)
    T_s = count * spacing_ns * 1e-9
    goals = []
    for j, axis in enumerate(table.axes):
        natural = splice.q[j] + 0.5 * splice.qd[j] * T_s  # where a gentle stop would end
        size = 0.3 * reach(table, j, T_s) * rng.uniform(-1.0, 1.0)
        goals.append(min(max(natural + size, axis.q_min), axis.q_max))
    tail = []
    for i in range(1, count + 1):
        columns = [_to_rest(splice, goals[j], j, T_s, i / count) for j in range(n)]
        q, qd, qdd = (pad_to_eight_axes(tuple(column[k] for column in columns)) for k in range(3))
        tail.append(Knot(splice.t_ns + i * spacing_ns, q, qd, qdd))
    return first, tuple(tail)


def _to_rest(start: Knot, goal: float, j: int, T: float, u: float) -> tuple[float, float, float]:
    """Joint j at u = t / T on the quintic from `start` to rest at `goal`."""
    q0, v0, a0 = start.q[j], start.qd[j] * T, start.qdd[j] * T * T
    h, dv, da = goal - q0 - v0 - 0.5 * a0, -v0 - a0, -a0
    c3, c4, c5 = 10.0 * h - 4.0 * dv + 0.5 * da, -15.0 * h + 7.0 * dv - da, 6.0 * h - 3.0 * dv + 0.5 * da
    if u >= 1.0:
        return goal, 0.0, 0.0
    return (
        q0 + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5)))),
        (v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / T,
        (a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / (T * T),
    )
