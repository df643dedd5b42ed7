"""Whether the camera keeps the OOI in view along a path, by the nominal mount."""

import numpy as np

from machine.boards import inner_corners
from machine.description import Machine, StereoCamera
from machine.poses import inverse_pose, pose, transform_points
from machine.visibility import faces_eye, in_both_eyes, marker_in_view
from server.motion.contracts import Array

CORNERS_MIN = 4  # of a chess board, for a pose


def markers_in_view(
    machine: Machine, Ts_base_tcp: Array, T_base_ooi: Array, R_tcp_cam: Array, margin_px: float
) -> Array:
    """How many of the OOI's markers both eyes see from each pose; a chess board counts as one while four corners are.

    Args:    Ts_base_tcp: (m, 4, 4); T_base_ooi: as estimated (4, 4); R_tcp_cam: nominal or calibrated (3, 3).
    Returns: counts (m,).
    """
    T_tcp_cam = pose(R_tcp_cam, machine.T_tcp_cam_left[:3, 3])
    markers = machine.markers_on("ooi")
    boards = [(one.T_on_board, inner_corners(one)) for one in machine.boards_on("ooi") if one.kind == "charuco"]
    counts = np.zeros(len(Ts_base_tcp))
    for k, T_base_tcp in enumerate(Ts_base_tcp):
        T_cam_ooi = inverse_pose(T_base_tcp @ T_tcp_cam) @ T_base_ooi
        counts[k] = sum(marker_in_view(machine.camera, T_cam_ooi, marker, margin_px) for marker in markers)
        counts[k] += sum(_board_in_view(machine.camera, T_cam_ooi @ T, corners, margin_px) for T, corners in boards)
    return counts


def _board_in_view(camera: StereoCamera, T_cam_board: Array, corners: Array, margin_px: float) -> bool:
    """Whether both eyes see the printed side and enough of its corners (n, 3)."""
    points = transform_points(T_cam_board, corners)
    if not faces_eye(T_cam_board[:3, 2], points.mean(axis=0)):
        return False
    return sum(in_both_eyes(camera, points[i : i + 1], margin_px) for i in range(len(points))) >= CORNERS_MIN
