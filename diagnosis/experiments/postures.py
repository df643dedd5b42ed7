"""Postures worth looking from: what is seen there, and choices of a dozen that differ in one respect."""

import numpy as np
from numpy.typing import NDArray

from diagnosis.experiments.library import Postures, posture_bounds
from diagnosis.log.nominal import Nominal
from machine.effects.layout import ParameterSets
from machine.effects.seen import seen_corners
from machine.effects.structure import gravity_torques, tcp_poses
from machine.rotations import Array

POSTURE_POOL_SIZE = 600
POSTURE_DISTANCE_MAX_RAD = 0.7  # from the middle of what was recorded
POSTURES_PER_CHOICE = 12
IMAGE_EDGE_MARGIN_PX = 8.0
MARKER_DEPTH_MIN_M = 0.25


def candidate_postures(nominal: Nominal, centre: Array, rng: np.random.Generator) -> Array:
    """Joint vectors (m, n) within the ranges and POSTURE_DISTANCE_MAX_RAD of a posture: half of them near it, half all
    over.

    Of a joint that was recorded outside its range, or has next to none, the nearest place inside.
    """
    lowest, highest = posture_bounds(nominal)
    centre = np.clip(centre, lowest, highest)
    low, high = (
        np.maximum(lowest, centre - POSTURE_DISTANCE_MAX_RAD),
        np.minimum(highest, centre + POSTURE_DISTANCE_MAX_RAD),
    )
    share = np.where(np.arange(POSTURE_POOL_SIZE) % 2 == 0, 1.0, 0.35)[:, None]
    return centre + share * (rng.uniform(low, high, (POSTURE_POOL_SIZE, nominal.n)) - centre)


def is_object_visible(nominal: Nominal, sets: ParameterSets, qs: Array, T_base_ooi: Array) -> NDArray[np.bool_]:
    """From which postures some marker of the object is whole in an eye (m,)."""
    markers = tuple(marker for marker in nominal.markers if marker.on == "ooi")
    if nominal.arm is None or nominal.camera is None or nominal.T_tcp_cam_left is None or not markers:
        return np.zeros(len(qs), dtype=bool)
    Ts = np.linalg.inv(tcp_poses(nominal.arm, sets, qs) @ nominal.T_tcp_cam_left) @ T_base_ooi
    corners = seen_corners(sets, nominal.camera, markers, Ts)
    size = np.array([nominal.camera.width_px, nominal.camera.height_px])
    whole = [
        (np.isfinite(px) & (px > IMAGE_EDGE_MARGIN_PX) & (px < size - IMAGE_EDGE_MARGIN_PX)).all(axis=(2, 3))
        for px in (corners.left_px, corners.right_px)
    ]
    in_front = (Ts[:, 2, 3] > MARKER_DEPTH_MIN_M) & (Ts[:, 2, 2] < -0.3)  # its printed side towards the camera
    return np.logical_or(whole[0], whole[1]).any(axis=-1) & in_front


def look_posture_choices(
    nominal: Nominal, sets: ParameterSets, qs: Array, T_base_ooi: Array | None
) -> tuple[Postures, ...]:
    """Choices among postures (m, n): near each other, at two distances, turned, at high and low load, all of it."""
    if len(qs) < POSTURES_PER_CHOICE or nominal.arm is None:
        return ()
    Ts = tcp_poses(nominal.arm, sets, qs)
    centre = qs.mean(axis=0)
    near = qs[np.argsort(np.abs(qs - centre).max(axis=1), kind="stable")[:POSTURES_PER_CHOICE]]
    features = {
        "postures across the range": (qs - centre) / POSTURE_DISTANCE_MAX_RAD,
        "postures of high and of low load": _relative_gravity_torques(nominal, sets, qs),
        "the wrist turned about several axes": Ts[:, :3, :3].reshape(len(qs), 9),
    }
    if T_base_ooi is not None:
        distance = np.linalg.norm(Ts[:, :3, 3] - T_base_ooi[:3, 3], axis=1)[:, None]
        features["two distances"] = distance
        features["two distances, the wrist turned"] = np.hstack(
            [2.0 * distance / max(float(np.ptp(distance)), 1e-9), Ts[:, :3, :3].reshape(len(qs), 9)]
        )
    spread = [Postures(name, qs[_farthest_point_rows(values)]) for name, values in features.items()]
    return (Postures("postures near each other", near), *spread)


def _relative_gravity_torques(nominal: Nominal, sets: ParameterSets, qs: Array) -> Array:
    """Gravity's torques (m, n) over the largest of each joint."""
    if nominal.arm is None:
        return np.zeros((len(qs), 1))
    torques = gravity_torques(nominal.arm, sets, qs)
    return torques / np.maximum(np.abs(torques).max(axis=0), 1.0)


def _farthest_point_rows(features: Array) -> NDArray[np.int64]:
    """POSTURES_PER_CHOICE rows, each as far as possible from those before it (Gonzalez 1985)."""
    chosen = [int(np.argmax(np.linalg.norm(features - features.mean(axis=0), axis=1)))]
    away = np.linalg.norm(features - features[chosen[0]], axis=1)
    while len(chosen) < POSTURES_PER_CHOICE:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)


def gravity_extremes(
    nominal: Nominal, sets: ParameterSets, qs: Array, joints: tuple[int, ...]
) -> tuple[Array, Array] | None:
    """Postures (n,) where gravity loads these joints most, and least; None where it never does."""
    if nominal.arm is None or float(nominal.arm.mass.sum()) <= 0.0:
        return None
    loads = np.abs(gravity_torques(nominal.arm, sets, qs)[:, list(joints)]).sum(axis=1)
    if float(loads.max()) < 10.0:
        return None
    return qs[int(np.argmax(loads))], qs[int(np.argmin(loads))]
