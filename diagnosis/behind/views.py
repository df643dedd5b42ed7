"""Poses of tool and OOI from marker corners in both eyes, as the nominal camera would have them."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from diagnosis.behind.points import rigid_fit
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import MarkerTable
from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.effects.encoders import true_angles
from machine.effects.layout import ParameterSets
from machine.effects.structure import tcp_poses
from machine.markers import object_corners
from machine.rotations import Array, rotvec_from_rotation

DISPARITY_MIN_FOCAL_FRAC = 1e-4  # of a focal length: farther than 1200 m at 0.12 m is not a marker
TIME_TOLERANCE_S = 1e-6


@dataclass(frozen=True, slots=True)
class Views:
    """Poses of an object in the left camera (m, 4, 4), seen by both eyes; t_s (m,) on the camera's clock."""

    t_s: Array
    Ts_cam_object: Array


def views_of(nominal: Nominal, table: MarkerTable, on: Literal["tool", "ooi"]) -> Views:
    """Every pair in which both eyes see at least one of the object's markers whole."""
    wanted = object_corners(marker for marker in nominal.markers if marker.on == on)
    camera = nominal.camera
    times: list[float] = []
    poses: list[Array] = []
    if camera is None or not wanted:
        return Views(np.zeros(0), np.zeros((0, 4, 4)))
    for t_s, both, left, right in pairs_of(table, wanted):
        points = triangulated(camera, left, right)
        if np.isfinite(points).all():
            times.append(t_s)
            poses.append(rigid_fit(np.concatenate([wanted[number] for number in both]), points))
    return Views(np.array(times), np.array(poses).reshape(-1, 4, 4))


def pairs_of(table: MarkerTable, wanted: Collection[int]) -> Iterator[tuple[float, list[int], Array, Array]]:
    """Pairs of one instant: time, ids of wanted markers that both eyes have, their corners (4 k, 2) by eye [px]."""
    order = np.argsort(table.t_s, kind="stable")
    cuts = np.nonzero(np.diff(table.t_s[order]) > TIME_TOLERANCE_S)[0] + 1
    for rows in np.split(order, cuts):
        seen = {(int(table.marker_ids[k]), int(table.eye[k])): table.corners_px[k] for k in rows}
        both = [number for number in wanted if (number, 0) in seen and (number, 1) in seen]
        if both:
            left, right = (np.concatenate([seen[number, eye] for number in both]) for eye in (0, 1))
            yield float(table.t_s[rows[0]]), both, left, right


def triangulated(camera: StereoCamera, left: Array, right: Array) -> Array:
    """Points (m, 3) [m] in the left eye's frame from pixels (m, 2) in both eyes; NaN where the rays do not meet."""
    rays_left, rays_right = undistort_to_rays(camera, left), undistort_to_rays(camera, right)
    disparity = rays_left[:, 0] - rays_right[:, 0]
    depth = camera.baseline_m / np.where(disparity > DISPARITY_MIN_FOCAL_FRAC, disparity, np.nan)
    row = 0.5 * (rays_left[:, 1] + rays_right[:, 1])
    return np.stack([rays_left[:, 0] * depth, row * depth, depth], axis=1)


def tool_residual(nominal: Nominal, views: Views) -> Array | None:
    """The tool in the camera against its nominal place (m, 6): x, y, z [m], then rotation vector [rad]; camera axes."""
    if nominal.T_tcp_cam_left is None or nominal.T_tcp_tool is None or len(views.t_s) == 0:
        return None
    T_cam_tool = np.linalg.inv(nominal.T_tcp_cam_left) @ nominal.T_tcp_tool
    return np.array([pose_difference(T_cam_tool, T) for T in views.Ts_cam_object])


def ooi_residual(nominal: Nominal, sets: ParameterSets, views: Views, q: Array, set_number: int = 0) -> Array | None:
    """Where each view has the OOI in the base, against their mean (m, 6); encoders q (m, n) at the views' times.

    Model: T_base_ooi = T_base_tcp(q) T_tcp_cam T_cam_ooi is one pose if joints, structure and camera are nominal.
    """
    if nominal.arm is None or nominal.T_tcp_cam_left is None or len(views.t_s) < 2:
        return None
    T_base_tcp = tcp_poses(nominal.arm, sets, true_angles(sets, q, set_number), set_number)
    T_base_ooi = T_base_tcp @ nominal.T_tcp_cam_left @ views.Ts_cam_object
    return np.array([pose_difference(mean_pose(T_base_ooi), T) for T in T_base_ooi])


def mean_pose(Ts: Array) -> Array:
    """Mean position, and the rotation nearest to the mean of the rotations (4, 4)."""
    u, _, vt = np.linalg.svd(Ts[:, :3, :3].mean(axis=0))
    out = np.eye(4)
    out[:3, :3] = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    out[:3, 3] = Ts[:, :3, 3].mean(axis=0)
    return out


def pose_difference(T_a: Array, T_b: Array) -> Array:
    """T_b less T_a (6,): position [m], then rotation vector of R_b R_a^T [rad], in the common frame's axes."""
    return np.concatenate([T_b[:3, 3] - T_a[:3, 3], rotvec_from_rotation(T_b[:3, :3] @ T_a[:3, :3].T)])
