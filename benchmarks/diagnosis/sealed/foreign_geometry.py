"""Geometry of the foreign crane from its published points: DH frames, masses, cylinder lengths, levers, weights.

The lift boom's x goes from pivot to pivot (the DH link), the tilt boom's along the boom; joint angles are the file's.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from benchmarks.diagnosis.sealed import foreign_numbers as k
from machine.rotations import Array

SKEW = float(np.arctan2(k.TILT_PIVOT[1], k.TILT_PIVOT[0]))  # the published boom's x axis lies this far below ours
A1, D1 = k.LIFT_PIVOT
A2 = float(np.hypot(*k.TILT_PIVOT))
A3 = k.BOOM_HIGH
GRID = 400


def flat(angle: float) -> Array:
    """Rotation in the boom's plane (2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def on_lift(point: tuple[float, ...]) -> Array:
    """A published point (3,) of the lift boom in our axes of it, origin at its pivot."""
    x, y = flat(-SKEW) @ np.array(point[:2])
    return np.array([x, y, point[2] if len(point) > 2 else 0.0])


def lift_length(q: float) -> float:
    """Lift cylinder's length [m] at the lift angle [rad]."""
    head = np.array(k.LIFT_PIVOT) + flat(q) @ on_lift(k.LIFT_HEAD)[:2]
    return float(np.linalg.norm(head - np.array(k.LIFT_FOOT)))


def bracket_angle(q: float) -> float:
    """Angle [rad] of bracket 1 against the lift boom where bracket 2 closes the loop with the tilt boom at q.

    Model: |pivot + R(b) tip - (tilt pivot + R(q) lug)| = rod: two circles about pivot and lug.
    """
    pivot, tilt = on_lift(k.BRACKET_PIVOT)[:2], np.array([A2, 0.0])
    lug = tilt + flat(q) @ np.array(k.TILT_LUG)
    tip = np.array(k.BRACKET_TIP)
    apart, radius = lug - pivot, float(np.linalg.norm(tip))
    distance = float(np.linalg.norm(apart))
    inside = (radius**2 + distance**2 - k.ROD_M**2) / (2.0 * radius * distance)
    course = np.arctan2(apart[1], apart[0]) + np.arccos(inside)  # the tip stays on the boom's upper side
    return float(np.angle(np.exp(1j * (course - np.arctan2(tip[1], tip[0])))))


def bracket_tip(q: float) -> Array:
    """Where cylinder and bracket 2 meet (2,) on the lift boom [m]."""
    return on_lift(k.BRACKET_PIVOT)[:2] + flat(bracket_angle(q)) @ np.array(k.BRACKET_TIP)


def tilt_length(q: float) -> float:
    """Tilt cylinder's length [m] at the tilt angle [rad]; it grows as the boom folds in."""
    return float(np.linalg.norm(bracket_tip(q) - on_lift(k.TILT_FOOT)[:2]))


@dataclass(frozen=True)
class Levers:
    """dL/dq [m] of each cylinder on a grid of its joint's angle: rows slew, lift, tilt."""

    low: Array
    step: Array
    table: Array


@cache
def levers() -> Levers:
    """Levers over the joints' ranges."""
    low, high = np.deg2rad(np.array(k.RANGES_DEG)).T
    grids = [np.linspace(a, b, GRID) for a, b in zip(low, high, strict=True)]
    h = 1e-6
    rows = [np.full(GRID, k.PITCH_RADIUS)]
    for length, grid in ((lift_length, grids[1]), (tilt_length, grids[2])):
        rows.append(np.array([(length(q + h) - length(q - h)) / (2.0 * h) for q in grid]))
    return Levers(low, (high - low) / (GRID - 1), np.array(rows))


def lever(joint: int, q: float) -> float:
    """dL/dq [m] of joint 0, 1 or 2."""
    one = levers()
    return float(np.interp((q - one.low[joint]) / one.step[joint], np.arange(GRID), one.table[joint]))


def in_link3(point: tuple[float, ...]) -> Array:
    """A published point (3,) of the tilt boom in the DH frame of link 3: x up from the boom, z along it."""
    x, y, z = (*point, 0.0)[:3]
    return np.array([y - A3, z, x])


@dataclass(frozen=True)
class Body:
    """One rigid body: mass [kg], centre of mass (3,) and inertia about it (3, 3), in its tree frame."""

    mass: float
    com: Array
    inertia: Array


def _body(mass: float, com: tuple[float, ...], moments: tuple[float, ...]) -> Body:
    return Body(mass, np.array(com), np.diag(moments))


def together(*bodies: Body) -> Body:
    """Several bodies as one; a negative mass takes one away."""
    mass = sum(one.mass for one in bodies)
    com = np.sum([one.mass * one.com for one in bodies], axis=0) / mass
    return Body(mass, com, np.sum([one.inertia + _steiner(one.mass, one.com - com) for one in bodies], axis=0))


def _steiner(mass: float, d: Array) -> Array:
    return mass * (float(d @ d) * np.eye(3) - np.outer(d, d))


def point_mass(mass: float, at: Array) -> Body:
    """A point mass."""
    return Body(mass, at, np.zeros((3, 3)))


def _less(body: Body, root: Body) -> Body:
    return together(body, Body(-root.mass, root.com, -root.inertia))


def tree_bodies(payload_kg: float = 0.0) -> tuple[Body, ...]:
    """Bodies of the tree's seven joints: slew, pillar's twist, lift, lift's bend, tilt, tilt's bend, bracket 1.

    Frames: pillar x forward, y left, z up; booms x along, y up, z right, at their pivots; bracket as published.
    """
    roots = [_body(*one) for one in zip(k.ROOT_KG, k.ROOT_COM, k.ROOT_I, strict=True)]
    x, y, z = k.PILLAR_COM
    pillar = _body(k.PILLAR_KG, (x, -z, y), (k.PILLAR_I[0], k.PILLAR_I[2], k.PILLAR_I[1]))
    lift = Body(k.LIFT_KG, on_lift(k.LIFT_COM), np.diag(k.LIFT_I))
    lug = point_mass(0.5 * k.ROD_KG, np.array([*k.TILT_LUG, 0.0]))
    tool = point_mass(k.TOOL_KG + payload_kg, tool_place())
    tilt = together(_body(k.TILT_KG, k.TILT_COM, k.TILT_I), tool)
    bracket = together(
        _body(k.BRACKET_KG, k.BRACKET_COM, k.BRACKET_I), point_mass(0.5 * k.ROD_KG, np.array([*k.BRACKET_TIP, 0.0]))
    )
    return (
        roots[0],
        _less(pillar, roots[0]),
        roots[1],
        _less(lift, roots[1]),
        together(roots[2], lug),
        _less(tilt, roots[2]),
        bracket,
    )


def tool_place() -> Array:
    """The tcp (3,) in the tilt boom's tree frame."""
    return np.array([k.BOOM_END, k.BOOM_HIGH, 0.0])


def tree_frames(q: Array) -> tuple[Array, Array]:
    """Frames R (7, 3, 3), p (7, 3) of the tree's bodies in base at tree angles (>= 6,) [rad]; the loop is closed."""
    upright, out_R, out_p = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.zeros((7, 3, 3)), []
    out_R[0] = turn(q[0])
    out_R[1] = out_R[0] @ turn(q[1])
    pivot = out_R[1] @ np.array([A1, 0.0, D1])
    out_R[2] = out_R[1] @ upright @ turn(q[2])
    out_R[3] = out_R[2] @ turn(q[3])
    elbow = pivot + out_R[3] @ np.array([A2, 0.0, 0.0])
    out_R[4] = out_R[3] @ turn(q[4])
    out_R[5] = out_R[4] @ turn(q[5])
    out_R[6] = out_R[3] @ turn(bracket_angle(float(q[4])))
    out_p = [np.zeros(3), np.zeros(3), pivot, pivot, elbow, elbow, pivot + out_R[3] @ on_lift(k.BRACKET_PIVOT)]
    return out_R, np.array(out_p)


def turn(angle: float) -> Array:
    """Rotation about z (3, 3)."""
    out = np.eye(3)
    out[:2, :2] = flat(angle)
    return out


def height_energy(bodies: tuple[Body, ...], q: Array) -> float:
    """Potential energy of the weights [J]."""
    R, p = tree_frames(q)
    return sum(one.mass * k.GRAVITY * float((R[i] @ one.com + p[i])[2]) for i, one in enumerate(bodies))


def weight_torques(bodies: tuple[Body, ...], q: Array) -> Array:
    """Torque of the weights about the first six joints (6,) [N m], the loop closed: -dU/dq."""
    out, h = np.zeros(6), 1e-5
    for i in range(6):
        step = np.zeros(len(q))
        step[i] = h
        out[i] = -(height_energy(bodies, q + step) - height_energy(bodies, q - step)) / (2.0 * h)
    return out


SPRUNG, DRIVEN = (1, 3, 5), (0, 2, 4)  # the tree's passive and driven joints


def at_rest(bodies: tuple[Body, ...], motors: Array) -> Array:
    """Tree angles (7,) [rad] at rest: springs bent by the weights, the linkage closed."""
    q = np.zeros(7)
    q[list(DRIVEN)] = motors
    for _ in range(8):
        q[list(SPRUNG)] = weight_torques(bodies, q)[list(SPRUNG)] / np.array(k.SPRINGS)
    q[6] = bracket_angle(float(q[4]))
    return q


def cylinder_forces(bodies: tuple[Body, ...], q: Array) -> Array:
    """Force of each cylinder (3,) [N] that holds the weights: virtual work, F dL = dU."""
    torques = weight_torques(bodies, q)[list(DRIVEN)]
    return -torques / np.array([lever(j, float(q[i])) for j, i in enumerate(DRIVEN)])
