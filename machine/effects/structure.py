"""True link poses: lengths, axis tilts, base tilt, and bending under gravity, vectorised over samples."""

import numpy as np
from numba import njit

from machine.effects.arm import Arm
from machine.effects.kernel import PAYLOAD
from machine.effects.layout import BASE_COMPLIANCE, BASE_TILT, LENGTH_A, LENGTH_D, SAG, TILT_X, TILT_Y, ParameterSets
from machine.errors import MachineError
from machine.rotations import Array

LOADED_TORQUE_MIN_NM = 1.0  # a joint that gravity loads less than this in every posture carries no load,
LOADED_TORQUE_MIN_FRAC = 0.01  # on a small machine less than this of the most loaded joint's,
LOADED_TORQUE_FLOOR_NM = 1e-3  # and on none this
N_TORQUE_POSTURES = 2048  # Halton points over the joints' ranges for the reference torques


@njit(cache=True)
def _rotation_from_rotvec(x: float, y: float, z: float, out: Array) -> None:
    """Rotation of a rotation vector into out (3, 3); exactly the identity at 0."""
    angle = np.sqrt(x * x + y * y + z * z)
    s = np.sin(angle) / angle if angle > 1e-9 else 1.0
    c = (1.0 - np.cos(angle)) / (angle * angle) if angle > 1e-9 else 0.5
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)


@njit(cache=True)
def _multiply_poses(A: Array, B: Array, out: Array) -> None:
    """Pose product A B; the last row of a pose is (0, 0, 0, 1)."""
    for i in range(3):
        for j in range(4):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        out[i, 3] += A[i, 3]
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@njit(cache=True)
def _compute_link_poses(
    before: Array,
    after: Array,
    zero: Array,
    moves: Array,
    prismatic: Array,
    tilts: Array,
    q: Array,
    bent: Array,
    links: Array,
    axes: Array,
) -> None:
    """Link poses (n + 1, 4, 4) from links[0] on, and each joint's axis and a point on it, axes (n, 2, 3)."""
    n = q.shape[0]
    T, M, R = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((3, 3))
    for i in range(n):
        _multiply_poses(links[i], before[i], T)
        if tilts[i, 0] != 0.0 or tilts[i, 1] != 0.0:
            _rotation_from_rotvec(tilts[i, 0], tilts[i, 1], 0.0, R)
            M[:3, :3] = R
            M[:3, 3] = 0.0
            M[3, 3] = 1.0
            _multiply_poses(T, M, links[i + 1])
            T[:] = links[i + 1]
        for r in range(3):
            axes[i, 0, r], axes[i, 1, r] = T[r, 2], T[r, 3]
        way = moves[i] * (zero[i] + q[i] + bent[i])
        angle, slide = way * (1.0 - prismatic[i]), way * prismatic[i]
        c, s = np.cos(angle), np.sin(angle)
        for r in range(3):
            x, y = T[r, 0], T[r, 1]
            T[r, 0], T[r, 1] = x * c + y * s, y * c - x * s
            T[r, 3] += T[r, 2] * slide
        _multiply_poses(T, after[i], links[i + 1])


@njit(cache=True)
def _compute_gravity_torques(
    links: Array,
    axes: Array,
    moves: Array,
    prismatic: Array,
    mass: Array,
    com: Array,
    gravity: Array,
    payload: float,
    tip: Array,
    out: Array,
) -> None:
    """Gravity's torque about each joint [N m] (prismatic: force along it), then its moment about the base's origin."""
    n = mass.shape[0]
    out[:] = 0.0
    for k in range(n + 1):
        kg = payload if k == n else mass[k]
        if kg == 0.0:
            continue
        T = links[n] if k == n else links[k + 1]
        at = tip if k == n else com[k]
        px = T[0, 0] * at[0] + T[0, 1] * at[1] + T[0, 2] * at[2] + T[0, 3]
        py = T[1, 0] * at[0] + T[1, 1] * at[1] + T[1, 2] * at[2] + T[1, 3]
        pz = T[2, 0] * at[0] + T[2, 1] * at[1] + T[2, 2] * at[2] + T[2, 3]
        fx, fy, fz = kg * gravity[0], kg * gravity[1], kg * gravity[2]
        out[n] += py * fz - pz * fy
        out[n + 1] += pz * fx - px * fz
        out[n + 2] += px * fy - py * fx
        for i in range(min(k + 1, n)):
            zx, zy, zz = axes[i, 0, 0], axes[i, 0, 1], axes[i, 0, 2]
            if prismatic[i] != 0.0:
                out[i] += zx * fx + zy * fy + zz * fz
                continue
            rx, ry, rz = px - axes[i, 1, 0], py - axes[i, 1, 1], pz - axes[i, 1, 2]
            out[i] += zx * (ry * fz - rz * fy) + zy * (rz * fx - rx * fz) + zz * (rx * fy - ry * fx)
    for i in range(n):
        out[i] *= moves[i]


@njit(cache=True, nogil=True)
def _compute_deflected_links(
    before: Array,
    after: Array,
    zero: Array,
    moves: Array,
    prismatic: Array,
    mass: Array,
    com: Array,
    gravity: Array,
    tip: Array,
    tilts: Array,
    sag: Array,
    base: Array,
    base_compliance: float,
    payload: float,
    qs: Array,
    links: Array,
    torques: Array,
) -> None:
    """Poses of every sample: once rigid, for gravity's torques, and again bent by them."""
    n = qs.shape[1]
    axes, none, bent = np.zeros((n, 2, 3)), np.zeros(n), np.zeros(n)
    R = np.zeros((3, 3))
    soft = base_compliance != 0.0 or np.any(sag != 0.0)
    for k in range(qs.shape[0]):
        _rotation_from_rotvec(base[0], base[1], base[2], R)
        links[k, 0, :, :] = 0.0
        links[k, 0, :3, :3] = R
        links[k, 0, 3, 3] = 1.0
        _compute_link_poses(before, after, zero, moves, prismatic, tilts, qs[k], none, links[k], axes)
        _compute_gravity_torques(links[k], axes, moves, prismatic, mass, com, gravity, payload, tip, torques[k])
        if soft:
            for i in range(n):
                bent[i] = sag[i] * torques[k, i]
            lean = base_compliance * torques[k, n:]
            _rotation_from_rotvec(base[0] + lean[0], base[1] + lean[1], base[2] + lean[2], R)
            links[k, 0, :3, :3] = R
            _compute_link_poses(before, after, zero, moves, prismatic, tilts, qs[k], bent, links[k], axes)


def link_poses(arm: Arm, sets: ParameterSets, qs: Array, which: int = 0) -> Array:
    """Ts_base_link (m, n + 1, 4, 4) at link-side joint vectors; entry 0 is the (tilted, leaning) base itself.

    Model:   joint i bends by compliance_i times gravity's torque about its axis, the base turns by base_compliance
             times gravity's moment about its origin, both at the unbent posture (second order: below 1 % of the sag).
    Args:    qs: (m, n) [rad, m where prismatic]. which: of the parameter sets.
    Raises:  MachineError: wrong shape or not finite.
    """
    return _link_poses_and_torques(arm, sets, qs, which)[0]


def tcp_poses(arm: Arm, sets: ParameterSets, qs: Array, which: int = 0) -> Array:
    """Ts_base_tcp (m, 4, 4) at link-side joint vectors (m, n)."""
    return link_poses(arm, sets, qs, which)[:, -1] @ arm.T_flange_tcp


def gravity_torques(arm: Arm, sets: ParameterSets, qs: Array, which: int = 0) -> Array:
    """Gravity's torque about each joint (m, n) [N m], positive where it drives the joint forward; rigid posture."""
    return _link_poses_and_torques(arm, sets, qs, which)[1][:, : arm.n]


def _link_poses_and_torques(arm: Arm, sets: ParameterSets, qs: Array, which: int) -> tuple[Array, Array]:
    qs = np.array(qs, dtype=float, order="C")
    if qs.ndim != 2 or qs.shape[1] != arm.n or not np.isfinite(qs).all():
        raise MachineError(f"joint vectors have shape {qs.shape}; the arm has {arm.n} joints: give finite (m, {arm.n})")
    P, G = sets.joint_parameters[which], sets.machine_parameters[which]
    before, after = arm.before.copy(), arm.after.copy()
    for column, row in ((LENGTH_A, 0), (LENGTH_D, 1)):
        before[:, :3, 3] += P[:, column, None] * arm.length_before[:, row]
        after[:, :3, 3] += P[:, column, None] * arm.length_after[:, row]
    tilts, sag = np.ascontiguousarray(P[:, [TILT_X, TILT_Y]]), np.ascontiguousarray(P[:, SAG])
    links, torques = np.zeros((len(qs), arm.n + 1, 4, 4)), np.zeros((len(qs), arm.n + 3))
    tip = np.ascontiguousarray(arm.T_flange_tcp[:3, 3])
    bodies = (arm.mass, arm.com, arm.gravity, tip)
    base = np.ascontiguousarray(G[BASE_TILT])
    fixed = (
        before,
        after,
        arm.q_offset,
        arm.motion_factor,
        arm.prismatic,
        *bodies,
        tilts,
        sag,
        base,
        G[BASE_COMPLIANCE],
        G[PAYLOAD],
    )
    _compute_deflected_links(*fixed, qs, links, torques)
    return links, torques


def reference_torques(arm: Arm, sets: ParameterSets, q_min: Array, q_max: Array) -> Array:
    """Largest torque of gravity (n,) [N m] over the joints' ranges; infinite where gravity never loads the joint.

    Model: over 2048 Halton points of the box q_min..q_max, so the same for the same machine file.
    """
    span = np.asarray(q_max, dtype=float) - np.asarray(q_min, dtype=float)
    qs = np.asarray(q_min, dtype=float) + span * _halton_points(N_TORQUE_POSTURES, arm.n)
    largest = np.abs(gravity_torques(arm, sets, qs)).max(axis=0)
    least = np.clip(LOADED_TORQUE_MIN_FRAC * largest.max(initial=0.0), LOADED_TORQUE_FLOOR_NM, LOADED_TORQUE_MIN_NM)
    return np.where(largest > least, largest, np.inf)


def loads_along(arm: Arm, sets: ParameterSets, qs: Array, torque_reference: Array) -> tuple[Array, Array]:
    """(load, load per kg at the tcp), each (m, n), along a motion (m, n): what the actuators' terms are driven by."""
    one = ParameterSets(sets.joint_parameters[:1].copy(), sets.machine_parameters[:1].copy())
    one.machine_parameters[0, PAYLOAD] = 0.0
    empty = gravity_torques(arm, one, qs)
    one.machine_parameters[0, PAYLOAD] = 1.0
    return empty / torque_reference, (gravity_torques(arm, one, qs) - empty) / torque_reference


def _halton_points(count: int, dims: int) -> Array:
    """Halton points (count, dims) in 0..1."""
    primes = [p for p in range(2, 100) if all(p % d for d in range(2, p))][:dims]
    points = np.zeros((count, dims))
    for axis, base in enumerate(primes):
        scale, left = 1.0, np.arange(1, count + 1)
        while left.any():
            scale /= base
            points[:, axis] += scale * (left % base)
            left //= base
    return points
