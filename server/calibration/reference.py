"""From a look to a reference: the paper's eq. 7-8 and 20-22, and the full-pose reference about the tool marker."""

import numpy as np

from machine.poses import pose, transform_points
from machine.rotations import quat_wxyz_from_rotation, rotation_from_quat_wxyz, skew
from server.calibration.checks import require_covariance, require_pose, require_rotation
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
    Source:  Makinen et al. 2023, eq. 7-8 and section 4.1 (camera parallel to the torsion axis).
    """
    N = require_rotation(R_tcp_cam_nominal, "R_tcp_cam_nominal")
    return orientation_reference_paper(R_base_tcp @ N, R_cam_ooi, R_cam_tool) @ N.T


def position_reference_paper(
    T_base_tcp: Array, R_base_cam: Array, p_cam_tool: Array, p_cam_ooi: Array, stand_off_m: float
) -> Array:
    """Reference pose of the TCP by eq. 20-22: a pure translation, the orientation is held.

    Model:   C_p_delta = p_O - p_T - (0, 0, b) (21); p_lc = R_fm R_cfa C_p_delta (20); p_ref = p_lc + B_p_T (22).
    Args:    T_base_tcp: present pose by the encoders (4, 4); R_base_cam: R_fm R_cfa (3, 3); p_cam_tool, p_cam_ooi: as
             seen (3,) [m]; stand_off_m: b, along the camera's z [m].
    Source:  Makinen et al. 2023, eq. 20-22.
    """
    T = require_pose(T_base_tcp, "T_base_tcp")
    p_delta = np.asarray(p_cam_ooi) - np.asarray(p_cam_tool) - np.array([0.0, 0.0, stand_off_m])  # eq. 21
    p_lc = require_rotation(R_base_cam, "R_base_cam") @ p_delta  # eq. 20
    return pose(T[:3, :3], p_lc + T[:3, 3])  # eq. 22


def reference_from_look(
    T_base_tcp: Array, R_tcp_cam: Array, T_tcp_tool: Array, T_cam_tool: Array, T_cam_ooi: Array, T_ooi_goal: Array
) -> Array:
    """Reference pose that puts the tool marker on its goal, measured as a step from where the encoders put the TCP.

    Model:   R_base_cam = R_base_tcp R_tcp_cam; T_cam_goal = T_cam_ooi T_ooi_goal; step of the marker d = R_base_cam
             (p_goal - p_tool); turn Q = R_base_cam R_cam_goal R_cam_tool^T R_base_cam^T; R_goal = Q R_base_tcp;
             p_goal = p_base_tool + d - R_goal p_tcp_tool: the turn is about the marker, so it does not move it.
    Args:    T_base_tcp: kinematics of the encoders at the look (4, 4); R_tcp_cam: the local calibration (3, 3);
             T_tcp_tool: nominal, its lever arm is used; T_cam_tool, T_cam_ooi: the look; T_ooi_goal: the tool's wanted
             pose, R = I, p = (x, y, b).
    Returns: T_base_tcp_goal, (4, 4), in the same space: where the encoders are to end.
    Source:  Makinen et al. 2023, eq. 7-8 and 20-22, joined and made frame-consistent.
    """
    T = require_pose(T_base_tcp, "T_base_tcp")
    T_cam_goal = require_pose(T_cam_ooi, "T_cam_ooi") @ require_pose(T_ooi_goal, "T_ooi_goal")
    T_tool = require_pose(T_cam_tool, "T_cam_tool")
    lever = require_pose(T_tcp_tool, "T_tcp_tool")[:3, 3]
    R_base_cam = T[:3, :3] @ require_rotation(R_tcp_cam, "R_tcp_cam")
    step = R_base_cam @ (T_cam_goal[:3, 3] - T_tool[:3, 3])
    turn = R_base_cam @ T_cam_goal[:3, :3] @ T_tool[:3, :3].T @ R_base_cam.T
    R_goal = turn @ T[:3, :3]
    p_base_tool = transform_points(T, lever[None])[0]
    return pose(R_goal, p_base_tool + step - R_goal @ lever)


def look_error_covariance(
    T_cam_tool: Array,
    T_cam_ooi: Array,
    T_ooi_goal: Array,
    tool_covariance: Array,
    ooi_covariance: Array,
    common: Array | None = None,
) -> Array:
    """Covariance of the measured tool-to-goal vector, from the look alone.

    Model:   p_goal = p_ooi + R_cam_ooi g, so an OOI turn acts through the lever g; the scatter of tool and OOI is
             independent, what all pairs have in common is not.
    Args:    poses as in `reference_from_look`; covariances (6, 6): rotation vector [rad], then translation [m], camera
             axes. common (12, 12): of tool, then OOI (`joint_lens.common_covariance`).
    Returns: (3, 3) [m^2], camera axes.
    """
    C_tool = require_covariance(tool_covariance, 6, "tool_covariance")
    C_ooi = require_covariance(ooi_covariance, 6, "ooi_covariance")
    require_pose(T_cam_tool, "T_cam_tool")
    lever = require_pose(T_cam_ooi, "T_cam_ooi")[:3, :3] @ np.asarray(T_ooi_goal)[:3, 3]
    both = np.zeros((12, 12)) if common is None else require_covariance(common, 12, "common").copy()
    both[:6, :6] += C_tool
    both[6:, 6:] += C_ooi
    J = np.hstack((np.zeros((3, 3)), -np.eye(3), -skew(lever), np.eye(3)))
    return J @ both @ J.T


def predicted_error_covariance(
    rotation_covariance: Array,
    R_tcp_cam: Array,
    T_cam_tool: Array,
    T_cam_ooi: Array,
    T_ooi_goal: Array,
    tool_covariance: Array,
    ooi_covariance: Array,
    common: Array | None = None,
    sigma_stretch_frac: float = 0.005,
    sigma_floor_m: float = 0.0007,
) -> Array:
    """Covariance of the tool's position error after the move, predicted before it.

    Model:   e = delta x d + stretch |d| + look + floor; d: step of the marker, delta: error of the camera's rotation,
             stretch: local length error of kinematics and odometry, floor: standstill, backlash, markers.
    Args:    rotation_covariance: of R_tcp_cam (3, 3) [rad^2], TCP axes; the look as in `look_error_covariance`;
             sigma_stretch_frac: sd of the relative length error, each axis; sigma_floor_m: sd each axis [m].
    Returns: (3, 3) [m^2], OOI axes; its diagonal's root is the predicted one sigma of x, y, z.
    """
    R_cam_tcp = require_rotation(R_tcp_cam, "R_tcp_cam").T
    in_camera = R_cam_tcp @ require_covariance(rotation_covariance, 3, "rotation_covariance") @ R_cam_tcp.T
    goal = (np.asarray(T_cam_ooi) @ require_pose(T_ooi_goal, "T_ooi_goal"))[:3, 3]
    d = goal - require_pose(T_cam_tool, "T_cam_tool")[:3, 3]
    look = look_error_covariance(T_cam_tool, T_cam_ooi, T_ooi_goal, tool_covariance, ooi_covariance, common)
    isotropic = (sigma_stretch_frac**2 * float(d @ d) + sigma_floor_m**2) * np.eye(3)
    total = skew(d) @ in_camera @ skew(d).T + look + isotropic
    R_ooi_cam = np.asarray(T_cam_ooi)[:3, :3].T
    return R_ooi_cam @ total @ R_ooi_cam.T
