"""Postures to look at an object from: those that together say most about arm, camera mount and the object's place.

Model:   greedy D-optimal design (Fedorov 1972) by cost: of all candidates the one that adds most, for each second that
         it takes, to log det of the information about zeros, lengths, sags, mount and the object's pose, with their
         priors; what is seen are marker corners.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.chain import Chain
from machine.description import Machine, Marker
from machine.effects.arm import arm_of
from machine.effects.encoders import angles_at_rest
from machine.effects.entries import EffectEntry, pack_effects
from machine.effects.registry import effect_of
from machine.effects.seen import seen_corners
from machine.effects.structure import gravity_torques, tcp_poses
from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from server.motion.contracts import Array, Wall
from server.motion.wall_clearance import clearances

POSTURE_POOL_SIZE = 12000
POSTURE_SPREAD_RAD = 0.6  # from the present posture
EDGE_PX, DEPTH_MIN_M, FACING_MIN = 50.0, 0.35, 0.35
MARKER_SIDE_MIN_PX = 22.0  # of a marker in the picture: smaller ones are not read for sure
CORNER_SIGMA_PX = 0.3
CANDIDATES_MAX = 400
EFFECT_PRIOR_SIGMAS = {"encoder_bias": 5e-3, "link_length_error": 4e-3, "gravity_sag": 1.5e-6}
MOUNT_RAD, MOUNT_M, OBJECT_RAD, OBJECT_M = 0.03, 0.01, 0.2, 0.2
LOOK_DURATION_S = 4.0  # to come to rest, look, and set off again
DERIVATIVE_STEP_SIGMAS = 1e-3  # of a prior's standard deviation: where the derivative is taken


@dataclass(frozen=True, slots=True)
class SeenObject:
    """Where the object of interest is (4, 4), its markers, and the camera's mount T_tcp_cam_left as far as known."""

    T_base_ooi: Array
    markers: tuple[Marker, ...]
    T_tcp_cam: Array


@dataclass(frozen=True, slots=True)
class Postures:
    """Chosen postures (k, n) [rad], in the order to visit them.

    `parameter_sigma_ratios`: (name, joint or None, standard deviation after over before) of every number that
    the looks bear upon.
    """

    q: Array
    parameter_sigma_ratios: tuple[tuple[str, int | None, float], ...]
    in_view: int


def choose_postures(
    machine: Machine, chain: Chain, q_now: Array, seen: SeenObject, wall: Wall | None, count: int, margin_rad: float
) -> Postures:
    """Up to `count` postures around q_now (n,) in which a marker is seen and the wall is far enough."""
    pool = _candidate_postures(chain, q_now, margin_rad)
    pool = pool[_in_view(machine, pool, seen)]
    if wall is not None and len(pool):
        tool = tcp_poses(arm_of(machine), pack_effects((), chain.n), pool)
        pool = pool[clearances(tool, machine.T_tcp_tool, wall) >= wall.clearance_min_m + 0.03]
    if not len(pool):
        return Postures(np.zeros((0, chain.n)), (), 0)
    pool = pool[:CANDIDATES_MAX]
    names, J = _whitened_jacobians(machine, pool, seen)
    places = tcp_poses(arm_of(machine), pack_effects((), chain.n), pool)[:, :3, 3] / (0.8 * machine.tcp_speed_max_m_s)
    chosen = _select_postures_greedily(J, places, min(count, len(pool)))
    left = np.sqrt(np.diag(np.linalg.inv(np.eye(len(names)) + sum(J[k].T @ J[k] for k in chosen))))
    known = tuple((*name, float(ratio)) for name, ratio in zip(names, left, strict=True) if name[0] != "object")
    return Postures(_in_order(places[[0, *chosen]], pool[chosen]), known, len(pool))


def _candidate_postures(chain: Chain, q_now: Array, margin_rad: float) -> Array:
    """Half of them near, half all over; the present one first."""
    rng = np.random.default_rng(57)
    low, high = chain.q_min + margin_rad, chain.q_max - margin_rad
    share = np.where(np.arange(POSTURE_POOL_SIZE) % 2 == 0, 1.0, 0.5)[:, None]
    drawn = q_now + share * rng.uniform(-POSTURE_SPREAD_RAD, POSTURE_SPREAD_RAD, (POSTURE_POOL_SIZE, chain.n))
    return np.concatenate([q_now[None], drawn[((drawn > low) & (drawn < high)).all(axis=1)]])


def _object_poses(machine: Machine, qs: Array, seen: SeenObject, entries: tuple[EffectEntry, ...] = ()) -> Array:
    sets = pack_effects(entries, qs.shape[1])
    Ts = tcp_poses(arm_of(machine), sets, angles_at_rest(sets, qs, None)) @ seen.T_tcp_cam
    return np.linalg.inv(Ts) @ seen.T_base_ooi


def _projected_corners(machine: Machine, Ts_cam_ooi: Array, seen: SeenObject, n: int) -> Array:
    """Both eyes' corners (m, 2, markers, 4, 2) [px]."""
    found = seen_corners(pack_effects((), n), machine.camera, seen.markers, Ts_cam_ooi)
    return np.stack([found.left_px, found.right_px], axis=1)


def _in_view(machine: Machine, qs: Array, seen: SeenObject) -> NDArray[np.bool_]:
    """Where a marker is whole in both eyes, large enough and not too flat (m,)."""
    Ts = _object_poses(machine, qs, seen)
    good = _readable_markers(machine, Ts, _projected_corners(machine, Ts, seen, qs.shape[1]))
    return np.asarray(good.any(axis=1))


def _readable_markers(machine: Machine, Ts_cam_ooi: Array, px: Array) -> NDArray[np.bool_]:
    """Which markers can be read in both eyes (m, markers)."""
    size = np.array([machine.camera.width_px, machine.camera.height_px])
    with np.errstate(invalid="ignore"):
        inside = (np.isfinite(px) & (px > EDGE_PX) & (px < size - EDGE_PX)).all(axis=(1, 3, 4))
        sides = np.linalg.norm(np.diff(px[:, 0], axis=2, append=px[:, 0, :, :1]), axis=3).min(axis=2)
    at = Ts_cam_ooi[:, :3, 3]
    facing = -(Ts_cam_ooi[:, :3, 2] * at).sum(axis=1) / np.linalg.norm(at, axis=1)
    near = (at[:, 2] > DEPTH_MIN_M) & (facing > FACING_MIN)
    return np.asarray(inside & (sides > MARKER_SIDE_MIN_PX) & near[:, None])


def _whitened_jacobians(machine: Machine, qs: Array, seen: SeenObject) -> tuple[list[tuple[str, int | None]], Array]:
    """Numbers that the looks bear upon, and whitened derivatives (m, rows, numbers), in units of the priors."""
    n = qs.shape[1]
    Ts = _object_poses(machine, qs, seen)
    base = _projected_corners(machine, Ts, seen, n)
    read = _readable_markers(machine, Ts, base)
    names, columns = [], []
    for name, joint, moved in _perturbed_object_poses(machine, qs, seen, Ts):
        change = (_projected_corners(machine, moved, seen, n) - base) / (DERIVATIVE_STEP_SIGMAS * CORNER_SIGMA_PX)
        change = np.where(read[:, None, :, None, None], np.nan_to_num(change), 0.0)
        names.append((name, joint))
        columns.append(change.reshape(len(qs), -1))
    return names, np.stack(columns, axis=2)


def _perturbed_object_poses(
    machine: Machine, qs: Array, seen: SeenObject, Ts: Array
) -> list[tuple[str, int | None, Array]]:
    """The object's poses in the camera with each number a small step off its nominal value."""
    out: list[tuple[str, int | None, Array]] = []
    for entry in _effects_to_perturb(machine, qs):
        out.append((entry.name, entry.joint, _object_poses(machine, qs, seen, (entry,))))
    for k, size in enumerate((*[MOUNT_RAD] * 3, *[MOUNT_M] * 3)):
        out.append(
            (
                "hand_eye_rotation" if k < 3 else "hand_eye_translation",
                None,
                inverse_pose(_small_pose_step(k, size)) @ Ts,
            )
        )
    out += [
        ("object", None, Ts @ _small_pose_step(k, size)) for k, size in enumerate((*[OBJECT_RAD] * 3, *[OBJECT_M] * 3))
    ]
    return out


def _small_pose_step(k: int, size: float) -> Array:
    step = np.zeros(6)
    step[k] = DERIVATIVE_STEP_SIGMAS * size
    return pose(rotation_from_rotvec(step[:3]), step[3:])


def _effects_to_perturb(machine: Machine, qs: Array) -> list[EffectEntry]:
    loads = np.abs(gravity_torques(arm_of(machine), pack_effects((), qs.shape[1]), qs)).max(axis=0)
    out = []
    for joint, (row, load) in enumerate(zip(machine.joints, loads, strict=True), start=1):
        out.append(_perturbed_effect("encoder_bias", joint))
        out += [
            _perturbed_effect("link_length_error", joint, of) for of in ("a", "d") if getattr(row, f"{of}_m") != 0.0
        ]
        out += [_perturbed_effect("gravity_sag", joint)] if load > 0.1 * float(loads.max()) else []
    return out


def _perturbed_effect(name: str, joint: int, option: str = "") -> EffectEntry:
    return EffectEntry(
        name, joint, ((effect_of(name).size.name, DERIVATIVE_STEP_SIGMAS * EFFECT_PRIOR_SIGMAS[name]),), option
    )


def _select_postures_greedily(J: Array, places_s: Array, count: int) -> list[int]:
    """The candidates that add most to log det(I + sum J'J) a second, one after the other.

    Args: places_s: (m, 3) of the TCP, as seconds at its speed; the first candidate is where the machine stands.
    """
    covariance = np.eye(J.shape[2])
    chosen: list[int] = []
    away_s = np.linalg.norm(places_s - places_s[0], axis=1)
    for _ in range(count):
        gains = np.linalg.slogdet(np.eye(J.shape[1]) + J @ covariance @ J.transpose(0, 2, 1))[1] / (
            LOOK_DURATION_S + away_s
        )
        gains[chosen] = -np.inf
        best = int(np.argmax(gains))
        away_s = np.minimum(away_s, np.linalg.norm(places_s - places_s[best], axis=1))
        chosen.append(best)
        S = np.eye(J.shape[1]) + J[best] @ covariance @ J[best].T
        covariance = covariance - covariance @ J[best].T @ np.linalg.solve(S, J[best] @ covariance)
    return chosen


def _in_order(places_s: Array, qs: Array) -> Array:
    """A short way through all postures from the first place and back to it: nearest next, then two-opt (Croes 1958).

    Args: places_s: (k + 1, 3), where the machine stands and where each posture (k, n) is, as seconds at its speed.
    """
    way = np.linalg.norm(places_s[:, None] - places_s, axis=2)
    order, left = [0], list(range(1, len(places_s)))
    while left:
        order.append(left.pop(int(np.argmin(way[order[-1], left]))))
    better = True
    while better:
        better = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                after = order[(j + 1) % len(order)]
                now = way[order[i - 1], order[i]] + way[order[j], after]
                if way[order[i - 1], order[j]] + way[order[i], after] < now - 1e-9:
                    order[i : j + 1] = order[i : j + 1][::-1]
                    better = True
    return qs[np.array(order[1:]) - 1]
