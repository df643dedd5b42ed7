"""What is driven: eight segments that begin and end at home, four of them repeats of one command."""

from dataclasses import dataclass

import numpy as np

from machine.rotations import Array

SPANS = np.array([0.30, 0.16, 0.20])  # half ranges at work [rad]
SPEED = np.array([0.16, 0.12, 0.15])  # largest speed of a quintic [rad/s]
SECONDS = 15.0
QUIET_S = 1.0  # at home between two segments


@dataclass(frozen=True, slots=True)
class Piece:
    """One segment of the programme: its kind, when it begins and ends [s]; `repeat`: of the first one."""

    name: str
    kind: str
    start_s: float
    end_s: float
    repeat: bool


def programme(rng: np.random.Generator, home: Array, step_s: float) -> tuple[Array, tuple[Piece, ...]]:
    """The command (m, n) [rad] every step_s, and its segments.

    The repeats' command holds a multisine, moves with dwells and a slow reversal, so that they differ by noise only.
    """
    mixed = np.concatenate(
        [_multisine(rng, 0.5 * SECONDS, step_s, len(home)), _moves(rng, 0.5 * SECONDS, step_s, len(home), 1.0)]
    )
    kinds = [("repeat", mixed)] * 4 + [
        ("steps", _moves(rng, SECONDS, step_s, len(home), 1.0)),
        ("workcycle", _moves(rng, SECONDS, step_s, len(home), 1.6)),
        ("staircase", _moves(rng, SECONDS, step_s, len(home), 0.25)),
        ("multisine", _multisine(rng, SECONDS, step_s, len(home))),
    ]
    rows, pieces, t = [np.zeros((round(QUIET_S / step_s), len(home)))], [], QUIET_S
    for number, (kind, course) in enumerate(kinds):
        end = t + len(course) * step_s
        pieces.append(Piece(f"{kind}{number}", kind, t, end, kind == "repeat"))
        rows += [course, np.zeros((round(QUIET_S / step_s), len(home)))]
        t = end + QUIET_S
    return home + np.concatenate(rows), tuple(pieces)


def _quintic(s: Array) -> Array:
    return 10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5


def _multisine(rng: np.random.Generator, seconds: float, step_s: float, n: int) -> Array:
    """Five sines of 0.08 to 0.7 Hz a joint, faded in and out."""
    t = np.arange(0.0, seconds, step_s)
    fade = _quintic(np.clip(np.minimum(t, seconds - t) / 1.5, 0.0, 1.0))
    out = np.zeros((len(t), n))
    for j in range(n):
        f = np.array([0.08, 0.16, 0.28, 0.45, 0.7]) * rng.uniform(0.85, 1.15, 5)
        share = np.array([0.35, 0.3, 0.15, 0.08, 0.04]) * SPANS[j % len(SPANS)]
        phase = rng.uniform(0.0, 2.0 * np.pi, 5)
        out[:, j] = (share * np.sin(2.0 * np.pi * f * t[:, None] + phase)).sum(axis=1)
    return out * fade[:, None]


def _moves(rng: np.random.Generator, seconds: float, step_s: float, n: int, scale: float) -> Array:
    """Quintic moves to random places with dwells between them; each joint on its own clock."""
    count = round(seconds / step_s)
    out = np.zeros((count, n))
    for j in range(n):
        at, now = 0, 0.0
        while at < count:
            goal = float(rng.uniform(-1.0, 1.0) * SPANS[j % len(SPANS)] * min(scale, 1.2))
            left = (count - at) * step_s
            speed = SPEED[j % len(SPEED)] * min(scale, 1.0) * float(rng.uniform(0.4, 1.0))
            move = max(0.4, 1.875 * abs(goal - now) / speed)
            back = max(0.6, 1.875 * abs(goal) / SPEED[j % len(SPEED)])
            if move + back + 0.3 > left:
                goal, move = 0.0, min(left, max(0.6, 1.875 * abs(now) / SPEED[j % len(SPEED)]))
            rows = min(count - at, max(1, round(move / step_s)))
            out[at : at + rows, j] = now + (goal - now) * _quintic(np.arange(1, rows + 1) / rows)
            at, now = at + rows, goal
            dwell = min(count - at, round(float(rng.uniform(0.2, 0.8)) / step_s))
            out[at : at + dwell, j] = now
            at += dwell
    return out
