"""What a joint's own motion sets swinging in its oil: a resonance, for which encoders alone have no name.

Why not among the other families: a baseline would have to know what an undisturbed machine shows of it. Without one it
refuses only where no other family says nearly as much: what a model's form leaves goes with everything a little.
"""

import math

import numpy as np
from numba import njit

from diagnosis.families.driven import Course, courses_of, modelled_of, placed, white_columns
from diagnosis.families.gain import held_out_nats
from diagnosis.refusal.remainder import Fired
from diagnosis.refusal.shapes import SINGLE_MOMENTS, TEST, Shape
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.cell import Cell
from machine.rotations import Array

FREQUENCIES_HZ = np.geomspace(0.8, 6.0, 12)
DAMPING = 0.1  # wide enough that a swing between two frequencies is a sum of both
STEP_RAD = 0.3  # of a swing's turn, at most
LEAST_NATS = 40.0
MORE = 3.0  # times what any other family says


def swinging(cell: Cell, left: Array, shapes: tuple[Shape, ...], gained_nats: float) -> tuple[Fired, ...]:
    """A refusal where swings foretell what a chosen model leaves (N,) far better than anything else does.

    Args: shapes: what else foretells it; gained_nats: what the chosen names gain.
    """
    if cell.stage != "actuator" or cell.usual or not isinstance(cell.whitened, Replay):
        return ()
    by_joint = np.split(_columns(cell, cell.whitened), len(cell.whitened.joints), axis=1)
    told = [held_out_nats(columns, left, cell.rows) for columns in by_joint]
    best = int(np.argmax(told))
    nats = told[best]
    others = [one.nats for one in shapes if one.goes_with != SINGLE_MOMENTS]
    if nats < max(LEAST_NATS, MORE * max(others, default=0.0)):
        return ()
    lead = f"swings after each move, at about {_strongest_hz(by_joint[best], left):.2g} Hz"
    share = nats / (nats + max(gained_nats, 0.0))
    return (Fired(TEST, cell.stage, cell.whitened.joints[best] + 1, nats, math.exp(-nats), lead, share),)


def _columns(cell: Cell, replay: Replay) -> Array:
    """(N, 2 frequencies joints), white as the cell's residual."""
    modelled, blocks = modelled_of(cell, replay), []
    for channel in range(len(replay.joints)):
        courses = courses_of(cell, replay, modelled, channel)
        white = [white_columns(replay.whitener, channel, one.dt_s, _swings(one)) for one in courses]
        blocks.append(np.concatenate(white))
    return placed(cell, replay, blocks)


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
