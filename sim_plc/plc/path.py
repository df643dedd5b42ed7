"""The path between knots and how it is run through: quintic segments, and a path speed that every joint can follow.

A path is a ring of knots: `times` (64,) [s] and `knots` (64, 3, n) with q, qd, qdd; index k lives in slot k % 64.
The path parameter sigma is the trajectory's own time [s]; rate = d sigma / dt is 1 at full speed.
"""

import numpy as np
from numba import njit

from machine.rotations import Array
from protocol.timeouts import KNOT_RING_CAPACITY

RING_SIZE_KNOTS = KNOT_RING_CAPACITY
_STILL = 1e-9  # rad/s: a joint this slow bounds nothing
_UNBOUNDED = 1e12
REST_SPEED_MAX_RAD_S = 1e-6  # rad/s: the speed at the end of a path, up to rounding


@njit(cache=True)
def path_point(times: Array, knots: Array, k: int, sigma: float, out: Array) -> None:
    """Point of the segment from knot k to k + 1 at path time sigma [s], into out (3, n).

    Model:   q(x) = q0 + v0 x + a0/2 x^2 + c3 x^3 + c4 x^4 + c5 x^5, x = (sigma - t_k) / T in 0..1, with q, q', q''
             of both knots met: position, speed and acceleration are continuous over knots.
    Returns: out[0] = q, out[1] = dq/dsigma, out[2] = d2q/dsigma2 [rad, s].
    """
    a, b = k % RING_SIZE_KNOTS, (k + 1) % RING_SIZE_KNOTS
    T = times[b] - times[a]
    x = (sigma - times[a]) / T
    for j in range(knots.shape[2]):
        q0, v0, a0 = knots[a, 0, j], knots[a, 1, j] * T, knots[a, 2, j] * T * T
        h = knots[b, 0, j] - q0 - v0 - 0.5 * a0
        dv = knots[b, 1, j] * T - v0 - a0
        da = knots[b, 2, j] * T * T - a0
        c3 = 10.0 * h - 4.0 * dv + 0.5 * da
        c4 = -15.0 * h + 7.0 * dv - da
        c5 = 6.0 * h - 3.0 * dv + 0.5 * da
        out[0, j] = q0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
        out[1, j] = (v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))) / T
        out[2, j] = (a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))) / (T * T)


@njit(cache=True)
def _first_guess(point: Array, rate: float, target: float, dt: float, qdd_max: Array) -> float:
    """The rate nearest to target after dt, from the accelerations now: |q'' rate^2 + q' rate'| <= qdd_max."""
    low, high = -_UNBOUNDED, _UNBOUNDED
    for j in range(point.shape[1]):
        v, a = point[1, j], point[2, j] * rate * rate
        if abs(v) > _STILL:
            bound = qdd_max[j] / abs(v)
            low = max(low, -bound - a / v)
            high = min(high, bound - a / v)
    return max(min(max(target, rate + min(low, 0.0) * dt), rate + max(high, 0.0) * dt), 0.0)


@njit(cache=True)
def _next_rate(point: Array, qd: Array, rate: float, target: float, dt: float, qdd_max: Array) -> float:
    """The rate nearest to target with which no speed steps by more than qdd_max dt.

    Model:   |q'(sigma after dt) rate_new - qd| <= qdd_max dt for every joint. Keeping the rate is always allowed: what
             the path itself demands was judged when its knots were taken.
    """
    low, high = 0.0, _UNBOUNDED
    for j in range(point.shape[1]):
        v = point[1, j]
        if abs(v) > _STILL:
            middle, reach = qd[j] / v, qdd_max[j] * dt / abs(v)
            low = max(low, middle - reach)
            high = min(high, middle + reach)
    return max(min(max(target, min(low, rate)), max(high, rate)), 0.0)


@njit(cache=True)
def _advance_path_position(times: Array, last: int, k: int, sigma: float, ahead: float) -> tuple[int, float]:
    """Segment and path time `ahead` [s] further on, not past knot `last`."""
    sigma = min(sigma + ahead, times[last % RING_SIZE_KNOTS])
    while k + 1 < last and sigma >= times[(k + 1) % RING_SIZE_KNOTS]:
        k += 1
    return k, sigma


@njit(cache=True)
def advance(
    times: Array,
    knots: Array,
    last: int,
    k: int,
    sigma: float,
    rate: float,
    target: float,
    dt: float,
    qdd_max: Array,
    out: Array,
) -> tuple[int, float, float]:
    """Move dt along the path with the rate going to target; never past knot `last`.

    Args:    k, sigma [s], rate: segment, path time and rate now; qdd_max: (n,) [rad/s2]; out: (3, n), written.
    Returns: k, sigma, rate after dt; out holds q_ref, qd_ref, qdd_ref [rad, s].
    """
    new_rate = rate
    if target != rate:
        path_point(times, knots, k, sigma, out)
        qd = out[1] * rate
        guess = _first_guess(out, rate, target, dt, qdd_max)
        k_guess, sigma_guess = _advance_path_position(times, last, k, sigma, 0.5 * (rate + guess) * dt)
        path_point(times, knots, k_guess, sigma_guess, out)
        new_rate = _next_rate(out, qd, rate, target, dt, qdd_max)
    k, sigma = _advance_path_position(times, last, k, sigma, 0.5 * (rate + new_rate) * dt)
    path_point(times, knots, k, sigma, out)
    for j in range(out.shape[1]):
        out[2, j] = out[2, j] * new_rate * new_rate + out[1, j] * (new_rate - rate) / dt
        out[1, j] *= new_rate
    return k, sigma, new_rate


@njit(cache=True)
def stop_time(
    times: Array, knots: Array, last: int, k: int, sigma: float, rate: float, dt: float, qdd_max: Array, limit_s: float
) -> float:
    """Time to rest along the path, braking as hard as the joints allow [s]; -1: longer than limit_s, or off its end."""
    out = np.empty((3, knots.shape[2]))
    elapsed = 0.0
    end = times[last % RING_SIZE_KNOTS]
    while rate > 0.0:
        if elapsed > limit_s:
            return -1.0
        k, sigma, rate = advance(times, knots, last, k, sigma, rate, 0.0, dt, qdd_max, out)
        elapsed += dt
        if sigma >= end and rate > 0.0:
            return elapsed if np.abs(out[1]).max() < REST_SPEED_MAX_RAD_S else -1.0
    return elapsed


@njit(cache=True)
def is_short_of_knots(
    times: Array,
    knots: Array,
    last: int,
    k: int,
    sigma: float,
    rate: float,
    target: float,
    dt: float,
    qdd_max: Array,
    limit_s: float,
) -> bool:
    """Whether one more cycle towards the target rate would leave too little path to come to rest on."""
    out = np.empty((3, knots.shape[2]))
    k, sigma, rate = advance(times, knots, last, k, sigma, rate, target, dt, qdd_max, out)
    if sigma >= times[last % RING_SIZE_KNOTS]:
        return True
    return stop_time(times, knots, last, k, sigma, rate, dt, qdd_max, limit_s) < 0.0


@njit(cache=True)
def ramp_down(out: Array, decel: Array, dt: float) -> bool:
    """Move dt with every joint braking by decel (n,) [rad/s2]; out (3, n): q, qd, qdd. Returns whether any moves on."""
    moving = False
    for j in range(out.shape[1]):
        before = out[1, j]
        step = decel[j] * dt
        after = max(before - step, 0.0) if before > 0.0 else min(before + step, 0.0)
        out[0, j] += 0.5 * (before + after) * dt
        out[1, j] = after
        out[2, j] = (after - before) / dt
        moving = moving or after != 0.0
    return moving


def warm_up(qdd_max: Array) -> None:
    """Compile the loops for the joints of `qdd_max` (n,), or load them from the cache, before a clock counts."""
    n = len(qdd_max)
    times, knots, out, decel = (
        np.zeros(RING_SIZE_KNOTS),
        np.zeros((RING_SIZE_KNOTS, 3, n)),
        np.zeros((3, n)),
        np.ones(n),
    )
    times[1] = 1.0
    advance(times, knots, 1, 0, 0.0, 1.0, 1.0, 1e-3, qdd_max, out)
    stop_time(times, knots, 1, 0, 0.0, 1.0, 1e-3, qdd_max, 1.0)
    is_short_of_knots(times, knots, 1, 0, 0.0, 1.0, 1.0, 1e-3, qdd_max, 1.0)
    ramp_down(out, decel, 1e-3)
