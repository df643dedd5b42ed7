"""Whether the camera keeps the OOI in view along a path, by the nominal mount."""

import numpy as np

from machine.description import Machine
from machine.poses import inverse_pose, pose
from machine.visibility import marker_in_view
from server.motion.contracts import Array


def markers_in_view(
    machine: Machine, Ts_base_tcp: Array, T_base_ooi: Array, R_tcp_cam: Array, margin_px: float
) -> Array:
    """How many of the OOI's markers both eyes see from each pose.

    Args:    Ts_base_tcp: (m, 4, 4); T_base_ooi: as estimated (4, 4); R_tcp_cam: nominal or calibrated (3, 3).
    Returns: counts (m,).
    """
    T_tcp_cam = pose(R_tcp_cam, machine.T_tcp_cam_left[:3, 3])
    markers = machine.markers_on("ooi")
    counts = np.zeros(len(Ts_base_tcp))
    for k, T_base_tcp in enumerate(Ts_base_tcp):
        T_cam_ooi = inverse_pose(T_base_tcp @ T_tcp_cam) @ T_base_ooi
        counts[k] = sum(marker_in_view(machine.camera, T_cam_ooi, marker, margin_px) for marker in markers)
    return counts
