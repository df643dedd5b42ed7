"""Orientation adjustment: the TCP rotation that makes the tool parallel to the OOI (eq. 7-8), printed and corrected."""

import numpy as np

from machine.rotations import quat_wxyz_from_rotation, rotation_from_quat_wxyz
from server.calibration.checks import require_rotation
from server.calibration.contracts import Array


def quat_product_wxyz(a_wxyz: Array, b_wxyz: Array) -> Array:
    """Hamilton product a b of two quaternions (w, x, y, z), so that R(a b) = R(a) R(b). Shapes (4,)."""
    aw, av, bw, bv = a_wxyz[0], a_wxyz[1:], b_wxyz[0], b_wxyz[1:]
    return np.concatenate(([aw * bw - av @ bv], aw * bv + bw * av + np.cross(av, bv)))


def orientation_reference_paper(R_base_tcp: Array, R_cam_ooi: Array, R_cam_tool: Array) -> Array:
    """Reference rotation of the TCP by eq. 7-8 exactly as printed.

    Model:   r_delta = r_O r_T^-1 (7); R_ref = R_BT R_delta (8).
    Note:    r_delta is expressed in camera axes but multiplied from the right, as if in TCP axes: right only when the
             camera's axes are parallel to the TCP's. `orientation_reference` is the frame-consistent form.
    Args:    R_base_tcp: present TCP; R_cam_ooi, R_cam_tool: as seen; each (3, 3).
    Returns: R_base_tcp_ref, (3, 3).
    Raises:  CalibrationInputError: an argument is not a rotation.
    Source:  Makinen et al. 2023, eq. 7-8.
    """
    r_O = quat_wxyz_from_rotation(require_rotation(R_cam_ooi, "R_cam_ooi"))
    r_T = quat_wxyz_from_rotation(require_rotation(R_cam_tool, "R_cam_tool"))
    r_T_inverse = r_T * np.array([1.0, -1.0, -1.0, -1.0])
    r_delta = quat_product_wxyz(r_O, r_T_inverse)  # eq. 7
    return require_rotation(R_base_tcp, "R_base_tcp") @ rotation_from_quat_wxyz(r_delta)  # eq. 8


def orientation_reference(R_base_tcp: Array, R_tcp_tool: Array, R_cam_tool: Array, R_cam_ooi: Array) -> Array:
    """Reference rotation of the TCP that makes the tool's axes parallel to the OOI's.

    Model:   R_ref = R_BT X (R_CT^T R_CO) X^T, X = R_tcp_tool: the error is taken in tool axes, then carried to the TCP.
             The camera's own mounting cancels; an error in X leaves only its commutator with the step, and iterating
             removes it.
    Args:    R_base_tcp: TCP by the encoders at the look; R_tcp_tool: nominal tool mounting; R_cam_tool,
             R_cam_ooi: as seen; each (3, 3).
    Returns: R_base_tcp_ref, (3, 3).
    Raises:  CalibrationInputError: an argument is not a rotation.
    Source:  Makinen et al. 2023, eq. 7-8, with the frames made consistent.
    """
    X = require_rotation(R_tcp_tool, "R_tcp_tool")
    R_tool_ooi = require_rotation(R_cam_tool, "R_cam_tool").T @ require_rotation(R_cam_ooi, "R_cam_ooi")
    return require_rotation(R_base_tcp, "R_base_tcp") @ X @ R_tool_ooi @ X.T


def orientation_reference_paper_axes(
    R_base_tcp: Array, R_tcp_cam_nominal: Array, R_cam_ooi: Array, R_cam_tool: Array
) -> Array:
    """Eq. 7-8 with the TCP's axes renamed to lie parallel to the camera's, as on the paper's machine.

    Model:   R_BT' = R_BT N, eq. 7-8 on R_BT', then back by N^T; N = nominal R_tcp_cam. Exact for a nominal mount.
    Args:    R_base_tcp, R_tcp_cam_nominal, R_cam_ooi, R_cam_tool: each (3, 3).
    Returns: R_base_tcp_ref, (3, 3).
    Raises:  CalibrationInputError: an argument is not a rotation.
    Source:  Makinen et al. 2023, eq. 7-8 and section 4.1 (camera parallel to the torsion axis).
    """
    N = require_rotation(R_tcp_cam_nominal, "R_tcp_cam_nominal")
    return orientation_reference_paper(R_base_tcp @ N, R_cam_ooi, R_cam_tool) @ N.T
