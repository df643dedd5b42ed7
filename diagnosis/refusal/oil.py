"""What a joint's own motion sets swinging in its oil: a resonance, for which encoders alone have no name.

Why not among the other families: a baseline would have to know what an undisturbed machine shows of it. Without one it
refuses only where no other family says nearly as much: what a model's form leaves goes with everything a little.
"""

import math

import numpy as np
from numba import njit

from diagnosis.families.common import share_of
from diagnosis.families.driven import Course, courses_of, modelled_of, placed, white_columns
from diagnosis.families.gain import foretold, held_out_nats
from diagnosis.families.quiet_loop import quiet_loop
from diagnosis.refusal.remainder import Fired
from diagnosis.refusal.shapes import SINGLE_MOMENTS, TEST, Shape
from diagnosis.replay.stage_replay import Replay
from diagnosis.replay.stretches import repeat_groups
from diagnosis.search.cell import Cell
from diagnosis.search.fit import costs
from diagnosis.search.score import Score
from machine.rotations import Array

FREQUENCIES_HZ = np.geomspace(0.8, 6.0, 12)
DAMPING = 0.1  # wide enough that a swing between two frequencies is a sum of both
STEP_RAD = 0.3  # of a swing's turn, at most
LEAST_NATS = 40.0
MORE = 3.0  # times what any other family says
TOLD_NATS = 8.0  # of the repeats: with less, they do not say what they have in common
COMMON_SHARE = 0.5  # of what is foretold of the repeats, by what their commands have in common


def swinging(cell: Cell, chosen: Score, shapes: tuple[Shape, ...], gained_nats: float) -> tuple[Fired, ...]:
    """A refusal where swings foretell what a chosen model leaves far better than anything else does.

    Args: shapes: what else foretells it; gained_nats: what the chosen names gain.
    """
    if cell.stage != "actuator" or cell.usual or not isinstance(cell.whitened, Replay):
        return ()
    replay, left = cell.whitened, chosen.held_out
    by_part = _by_part(cell, replay)
    by_joint = np.split(_end_to_end(cell, replay, by_part), len(replay.joints), axis=1)
    told = [held_out_nats(columns, left, cell.rows) for columns in by_joint]
    best = int(np.argmax(told))
    nats = told[best]
    others = [one.nats for one in shapes if one.goes_with != SINGLE_MOMENTS]
    if nats < max(LEAST_NATS, MORE * max(others, default=0.0)) or _is_own_noise(cell, replay, by_part, chosen, best):
        return ()
    lead = f"swings after each move, at about {_strongest_hz(by_joint[best], left):.2g} Hz"
    share = nats / (nats + max(gained_nats, 0.0))
    return (Fired(TEST, cell.stage, replay.joints[best] + 1, nats, math.exp(-nats), lead, share),)


def _end_to_end(cell: Cell, replay: Replay, by_part: list[list[Array]]) -> Array:
    """Columns by joint and stretch at the cell's rows (N, columns)."""
    return placed(cell, replay, [np.concatenate(parts) for parts in by_part])


def _by_part(cell: Cell, replay: Replay) -> list[list[Array]]:
    """By joint and stretch (rows, 2 frequencies), white as the cell's residual."""
    modelled = modelled_of(cell, replay)
    return [
        [
            white_columns(replay.whitener, channel, one.dt_s, _swings(one))
            for one in courses_of(cell, replay, modelled, channel)
        ]
        for channel in range(len(replay.joints))
    ]


def _is_own_noise(cell: Cell, replay: Replay, by_part: list[list[Array]], chosen: Score, channel: int) -> bool:
    """Whether what foretells the repeats is not what they have in common, nor what an undisturbed loop would swing by.

    Why: through a fast loop the measured command answers the disturbance that the residual is made of, and a swing that
         follows such a command foretells it: 90 to 190 nats on sound machines whose residual was all within their
         noise. What a boom's moves set swinging is the same in every repeat.
    """
    left, quiet = chosen.held_out, quiet_loop(cell)
    if quiet is not None:
        undisturbed = quiet.driven(chosen.fit)
        columns = (_end_to_end(cell, replay, by_part), _end_to_end(cell, replay, _by_part(cell, undisturbed)))
        own, instead = (foretold(one, left, cell.rows) for one in columns)
        share = share_of(left, own, instead)
        return share is not None and share < COMMON_SHARE
    groups = repeat_groups(tuple(part.stretch for part in replay.parts))
    names = [part.stretch.name for part in replay.parts]
    common, repeated = (
        [parts[:] for parts in by_part],
        [[np.zeros((len(own), 1)) for own in parts] for parts in by_part],
    )
    for members in groups.values():
        numbers = [names.index(one.name) for one in members]
        for parts, marks in zip(common, repeated, strict=True):
            rows = min(len(parts[k]) for k in numbers)
            mean = np.mean([parts[k][:rows] for k in numbers], axis=0)
            for k in numbers:
                parts[k] = np.concatenate([mean, parts[k][rows:]])
                marks[k] = np.ones((len(parts[k]), 1))
    own, mean = (_end_to_end(cell, replay, one) for one in (by_part, common))
    in_repeats = _end_to_end(cell, replay, repeated).any(axis=1)
    width = own.shape[1] // len(replay.joints)
    at = slice(channel * width, (channel + 1) * width)
    by_own, by_common = (
        float((costs(left) - costs(left - foretold(columns[:, at], left, cell.rows)))[in_repeats].sum())
        for columns in (own, mean)
    )
    return by_own > TOLD_NATS and by_common < COMMON_SHARE * by_own


def _swings(course: Course) -> Array:
    """What each swing adds to the angle, and its own speed (m, 2 frequencies)."""
    speed = np.ascontiguousarray(course.rate(course.q))
    columns: list[Array] = []
    for w in 2.0 * np.pi * FREQUENCIES_HZ:
        whole, faster = _swung(speed, course.dt_s, float(w), DAMPING)
        columns += [whole, faster / w]
    return np.stack(columns, axis=1)


@njit(cache=True)
def _swung(speed: Array, dt_s: float, w: float, damping: float) -> tuple[Array, Array]:
    """Of a speed (m,) that oil and mass follow as an oscillator: how far that leads, and how much faster it is (m,)."""
    whole, faster = np.zeros(len(speed)), np.zeros(len(speed))
    s, sd, far = speed[0], 0.0, 0.0
    steps = max(1, int(np.ceil(w * dt_s / STEP_RAD)))
    dt = dt_s / steps
    for i in range(len(speed)):
        for _ in range(steps):
            sd += dt * (w * w * (speed[i] - s) - 2.0 * damping * w * sd)
            s += dt * sd
            far += dt * (s - speed[i])
        whole[i], faster[i] = far, s - speed[i]
    return whole, faster


def _strongest_hz(columns: Array, left: Array) -> float:
    """The frequency whose columns alone explain most."""
    size = np.linalg.norm(columns, axis=0)
    explained = (columns.T @ left / np.where(size > 0.0, size, 1.0)) ** 2
    return float(FREQUENCIES_HZ[int(np.argmax(explained.reshape(-1, 2).sum(axis=1)))])
