"""Poses of an object from the corners of one marker in one eye: coarse, a start for what is fitted to the corners."""

from typing import Literal

import numpy as np

from diagnosis.behind.views import TIME_TOLERANCE_S, Views
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import MarkerTable
from machine.camera import undistort_to_rays
from machine.markers import marker_corners
from machine.rotations import Array


def one_eye_views(nominal: Nominal, table: MarkerTable, on: Literal["tool", "ooi"]) -> Views:
    """The object's pose in the left camera by the largest of its markers that the left eye sees in each frame."""
    markers = {marker.marker_id: marker for marker in nominal.markers if marker.on == on}
    if nominal.camera is None or not markers:
        return Views(np.zeros(0), np.zeros((0, 4, 4)))
    wanted = np.array([int(i) in markers for i in table.marker_ids]) & (table.eye == 0) & np.isfinite(table.t_s)
    rows = np.nonzero(wanted & np.isfinite(table.corners_px).all(axis=(1, 2)))[0]
    rows = rows[np.argsort(table.t_s[rows], kind="stable")]
    times: list[float] = []
    poses: list[Array] = []
    for group in np.split(rows, np.nonzero(np.diff(table.t_s[rows]) > TIME_TOLERANCE_S)[0] + 1):
        if not len(group):
            continue
        row = max(group, key=lambda k: float(np.ptp(table.corners_px[k], axis=0).min()))
        marker = markers[int(table.marker_ids[row])]
        T_cam_marker = planar_pose(
            marker_corners(marker.side_m), undistort_to_rays(nominal.camera, table.corners_px[row])
        )
        times.append(float(table.t_s[row]))
        poses.append(T_cam_marker @ np.linalg.inv(marker.T_on_marker))
    return Views(np.array(times), np.array(poses).reshape(-1, 4, 4))


def planar_pose(points: Array, rays: Array) -> Array:
    """T_cam_marker (4, 4) from four points (4, 3) [m] in their plane z = 0 and their rays (4, 2) at depth 1.

    Model:  rays ~ H (x, y, 1) by the direct linear transform; H = s (r1, r2, t), r1 and r2 made orthonormal.
    Source: Zhang 2000, section 3.1.
    """
    rows = []
    for (x, y, _), (u, v) in zip(points, rays, strict=True):
        rows += [[x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u], [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, -v]]
    H = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    H = H if H[2, 2] > 0.0 else -H
    u, _, vt = np.linalg.svd(np.stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])], axis=1))
    T = np.eye(4)
    T[:3, :3] = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    T[:3, 3] = H[:, 2]
    return T
