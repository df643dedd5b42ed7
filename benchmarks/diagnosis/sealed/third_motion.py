"""The third plant's programmes: what an identification drives, what one job of a normal day drives, and rests."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.diagnosis.sealed.third_arm import Array

SPAN = np.array([0.10, 0.085, 0.105, 0.14, 0.14, 0.18])  # half of the range that is driven about home [rad]
SPEED = np.array([0.11, 0.08, 0.11, 0.16, 0.16, 0.18])  # largest speed of a move [rad/s]
REPEATS = 4
Part = Callable[[np.random.Generator, float, float, int], Array]


@dataclass(frozen=True)
class Segment:
    """One segment of run.toml: name, kind, when it begins and ends [s], and what it repeats."""

    name: str
    kind: str
    start_s: float
    end_s: float
    repeat_of: str = ""


def _smooth(s: Array) -> Array:
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _faded(out: Array, t: Array, seconds: float, fade_s: float = 1.0) -> Array:
    return out * _smooth(np.clip(np.minimum(t, seconds - t) / fade_s, 0.0, 1.0))[:, None]


def multisine(rng: np.random.Generator, seconds: float, step_s: float, n: int) -> Array:
    """Six sines of 0.07 to 1 Hz a joint, the faster the smaller."""
    t = np.arange(round(seconds / step_s)) * step_s
    out = np.zeros((len(t), n))
    for j in range(n):
        f = np.exp(rng.uniform(np.log(0.07), np.log(1.0), 6))
        share = rng.uniform(0.3, 1.0, 6) / f**0.7
        waves = np.sin(2.0 * np.pi * f * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, 6)) @ share
        out[:, j] = SPAN[j] * waves / np.abs(waves).max()
    return _faded(out, t, seconds)


def steps(rng: np.random.Generator, seconds: float, step_s: float, n: int) -> Array:
    """Fast moves of 0.6 s to random places, a dwell of 0.6 to 2 s at each; every joint on its own clock."""
    return _moves(rng, seconds, step_s, n, lambda _j, _by: 0.6, (0.6, 2.0))


def workcycle(rng: np.random.Generator, seconds: float, step_s: float, n: int) -> Array:
    """All joints move together to eight places and rest at each."""
    count = round(seconds / step_s)
    each = count // 8
    out, now = np.zeros((count, n)), np.zeros(n)
    for k in range(8):
        goal = np.zeros(n) if k == 7 else rng.uniform(-1.0, 1.0, n) * SPAN[:n]
        move = round(0.65 * each)
        out[k * each : k * each + move] = now + (goal - now) * _smooth(np.arange(1, move + 1) / move)[:, None]
        out[k * each + move :], now = goal, goal
    return out


def slow_passes(rng: np.random.Generator, seconds: float, step_s: float, n: int) -> Array:
    """One slow sine a joint with a period of its own: its speed passes zero both ways again and again."""
    t = np.arange(round(seconds / step_s)) * step_s
    period = seconds / rng.permutation(np.linspace(1.3, 3.2, n))
    waves = np.sin(2.0 * np.pi * t[:, None] / period) * SPAN[:n] * rng.choice((-0.85, 0.85), n)
    return _faded(waves, t, seconds)


def staircase(rng: np.random.Generator, seconds: float, step_s: float, n: int) -> Array:
    """Stairs of a few milliradians up and down again, with rests."""
    count = round(seconds / step_s)
    each = round(1.5 / step_s)
    stairs = max(1, count // each)
    level = np.minimum(np.arange(stairs), np.arange(stairs)[::-1])
    held = np.repeat(level, each)
    held = np.concatenate([held, np.zeros(max(0, count - len(held)))])[:count]
    rise = np.ones(round(0.3 / step_s)) / round(0.3 / step_s)
    soft = np.convolve(held, rise)[:count]
    return soft[:, None] * rng.uniform(0.03, 0.12, n) * SPAN[:n] * rng.choice((-1.0, 1.0), n)


def rests(rng: np.random.Generator, seconds: float, step_s: float, n: int) -> Array:
    """Small moves between postures with long rests, as a camera looks at one object from a few places."""
    return _moves(rng, seconds, step_s, n, lambda j, by: max(0.8, 1.875 * abs(by) / SPEED[j]), (2.5, 4.0))


def positioning(rng: np.random.Generator, seconds: float, step_s: float, n: int) -> Array:
    """One job: ahead in one long move, a rest to look, three ever smaller corrections with rests, and back."""
    count = round(seconds / step_s)
    shares = (1.0, 0.12, 0.03, 0.01)
    goal = rng.choice((-1.0, 1.0), n) * rng.uniform(1.0, 2.0, n) * SPAN[:n]
    goals = [goal + (0.0 if k == 0 else 1.0) * share * rng.normal(size=n) * SPAN[:n] for k, share in enumerate(shares)]
    out, now, at = np.zeros((count, n)), np.zeros(n), round(1.0 / step_s)
    for k, to in enumerate([*goals, np.zeros(n)]):
        move = round((9.0 if k in (0, len(goals)) else 2.0) / step_s)
        rest = round(5.5 / step_s)
        path = now + (to - now) * _smooth(np.arange(1, move + 1) / move)[:, None]
        rows = min(move, count - at)
        out[at : at + rows] = path[:rows]
        out[at + rows :], now, at = to, to, min(at + move + rest, count)
    return out


def _moves(
    rng: np.random.Generator,
    seconds: float,
    step_s: float,
    n: int,
    lasts: Callable[[int, float], float],
    dwell_s: tuple[float, float],
) -> Array:
    count = round(seconds / step_s)
    out = np.zeros((count, n))
    for j in range(n):
        at, now = 0, 0.0
        while at < count:
            goal = float(rng.uniform(-1.0, 1.0) * SPAN[j])
            left = (count - at) * step_s
            if left < lasts(j, goal - now) + lasts(j, goal) + dwell_s[1] + 0.5:
                goal = 0.0
            rows = min(count - at, max(1, round(lasts(j, goal - now) / step_s)))
            out[at : at + rows, j] = now + (goal - now) * _smooth(np.arange(1, rows + 1) / rows)
            at, now = at + rows, goal
            out[at:, j] = goal
            at += round(float(rng.uniform(*dwell_s)) / step_s) if goal != 0.0 or left > 3.0 else count
    return out


IDENTIFY = (
    ("multisine", multisine, 30.0),
    ("steps", steps, 30.0),
    ("sweep", slow_passes, 40.0),
    ("staircase", staircase, 30.0),
    ("workcycle", workcycle, 40.0),
    ("multisine", multisine, 20.0),
)


def programme(
    kind: str, rng: np.random.Generator, home: Array, step_s: float, shorten: float = 1.0
) -> tuple[Array, tuple[Segment, ...]]:
    """The sent reference (m, n) [rad], one row every step_s, and its segments.

    Args: kind: "identify" with repeats, "no_repeats", "one_job" or "rests". shorten: of every length, for tests.
    """
    n = len(home)
    parts: list[tuple[str, Array, str]] = []
    if kind == "one_job":
        parts = [("positioning", positioning(rng, 60.0 * shorten, step_s, n), "")]
    elif kind == "rests":
        parts = [("hold", rests(rng, 60.0 * shorten, step_s, n), "")]
    else:
        if kind == "identify":
            command = multisine(rng, 15.0 * shorten, step_s, n)
            parts = [("repeat", command, "r0")] * REPEATS
        parts += [(name, make(rng, seconds * shorten, step_s, n), "") for name, make, seconds in IDENTIFY]
    segments, t = [], 0.0
    for number, (name, rows, again) in enumerate(parts):
        end = t + len(rows) * step_s
        segments.append(Segment(f"{name}_{number}", name, t, end, again))
        t = end
    return home + np.concatenate([rows for _, rows, _ in parts]), tuple(segments)
