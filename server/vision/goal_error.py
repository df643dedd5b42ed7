"""What is left to the goal: tool minus goal in OOI axes, with one sigma of everything."""

from dataclasses import dataclass

import numpy as np

from machine.poses import inverse_pose
from machine.rotations import rotvec_from_rotation, skew
from server.vision.contracts import Array, Look, ObjectPose
from server.vision.errors import NoPoseError


@dataclass(frozen=True, slots=True)
class PrintSigmas:
    """How well the printed targets are known, one sigma; no mean over pairs shrinks these.

    side_frac: a printed side's length, relative: it scales the object's distance from the camera. layout_m and
    layout_rad: where the object's markers sit on it as a whole (T_on_marker), which turns and shifts its axes.
    """

    side_frac: float = 0.0
    layout_m: float = 0.0
    layout_rad: float = 0.0


EXACT_PRINTS = PrintSigmas()


def with_print_errors(T_cam_object: Array, covariance: Array, prints: PrintSigmas, stereo_share: float = 0.0) -> Array:
    """Covariance (6, 6) of an object's pose with the errors of its printed targets.

    Model:   C + diag(layout_rad^2 I, layout_m^2 I) + side_frac^2 (1 - share)^2 [0, t][0, t]^T: a print too large
             by some share puts the object that much too far along the line of sight t, where the eyes' own range
             (`stereo_share` of the weight, 0 to 1) does not hold against it.
    Args:    T_cam_object (4, 4); covariance as ObjectPose, camera axes.
    """
    along = np.concatenate([np.zeros(3), T_cam_object[:3, 3] * prints.side_frac * (1.0 - stereo_share)])
    placed = np.repeat([prints.layout_rad**2, prints.layout_m**2], 3)
    return covariance + np.diag(placed) + np.outer(along, along)


@dataclass(frozen=True, slots=True)
class PoseError:
    """Tool minus goal in OOI axes: position (3,) [m], rotation vector (3,) [rad]; `angle_rad` is the geodesic angle."""

    position_m: Array
    sigma_position_m: Array
    rotvec_rad: Array
    sigma_rotvec_rad: Array
    angle_rad: float
    sigma_angle_rad: float

    @property
    def distance_m(self) -> float:
        """Length of the position error [m]."""
        return float(np.linalg.norm(self.position_m))


def pose_error(
    T_cam_tool: Array, T_cam_ooi: Array, T_ooi_goal: Array, tool_covariance: Array, ooi_covariance: Array
) -> PoseError:
    """Error of the tool against the goal in OOI axes, first-order sigmas.

    Model:   p = R_o^T (t_t - t_o) - p_goal; rotvec = log(R_o^T R_t R_goal^T). With left perturbations w in camera axes:
             dp = R_o^T (dt_t - dt_o + [t_t - t_o]x w_o), drotvec = R_o^T (w_t - w_o) for a small error.
    Args:    poses (4, 4) in the left camera; covariances (6, 6), rotation [rad] then position [m].
    Returns: PoseError.
    """
    R_ooi_cam = T_cam_ooi[:3, :3].T
    T_ooi_tool = inverse_pose(T_cam_ooi) @ T_cam_tool
    arm = T_cam_tool[:3, 3] - T_cam_ooi[:3, 3]
    J_tool = np.zeros((6, 6))
    J_tool[:3, 3:], J_tool[3:, :3] = R_ooi_cam, R_ooi_cam
    J_ooi = np.zeros((6, 6))
    J_ooi[:3, :3], J_ooi[:3, 3:], J_ooi[3:, :3] = R_ooi_cam @ skew(arm), -R_ooi_cam, -R_ooi_cam
    covariance = J_tool @ tool_covariance @ J_tool.T + J_ooi @ ooi_covariance @ J_ooi.T
    rotvec = rotvec_from_rotation(T_ooi_tool[:3, :3] @ T_ooi_goal[:3, :3].T)
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return PoseError(
        position_m=T_ooi_tool[:3, 3] - T_ooi_goal[:3, 3],
        sigma_position_m=sigmas[:3],
        rotvec_rad=rotvec,
        sigma_rotvec_rad=sigmas[3:],
        angle_rad=float(np.linalg.norm(rotvec)),
        sigma_angle_rad=_sigma_of_angle(rotvec, covariance[3:, 3:]),
    )


def _sigma_of_angle(rotvec: Array, covariance: Array) -> float:
    """Sigma along the error's own axis; the largest one where the error is too small to have an axis."""
    angle = float(np.linalg.norm(rotvec))
    largest = float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
    if angle < largest:
        return largest
    axis = rotvec / angle
    return float(np.sqrt(max(axis @ covariance @ axis, 0.0)))


def error_to_goal(
    look: Look, T_ooi_goal: Array, tool_prints: PrintSigmas = EXACT_PRINTS, ooi_prints: PrintSigmas = EXACT_PRINTS
) -> PoseError:
    """Error of a look that has poses.

    Args:    tool_prints, ooi_prints: what the mean over pairs cannot shrink. An error of the OOI's axes (layout_rad)
             counts by its lever arm, the way from the OOI to the tool, so that the sigmas grow with the distance.

    Raises: NoPoseError when the look failed.
    """
    if look.T_cam_tool is None or look.T_cam_ooi is None or look.tool_covariance is None or look.ooi_covariance is None:
        raise NoPoseError(f"look {look.status.value} has no poses: {look.reason}; look again")
    tool = with_print_errors(look.T_cam_tool, look.tool_covariance, tool_prints)
    ooi = with_print_errors(look.T_cam_ooi, look.ooi_covariance, ooi_prints)
    return pose_error(look.T_cam_tool, look.T_cam_ooi, T_ooi_goal, tool, ooi)


def pair_error(tool: ObjectPose, ooi: ObjectPose, T_ooi_goal: Array) -> PoseError:
    """Error in one pair, for display.

    Raises: NoPoseError when one of the objects has no pose.
    """
    for found in (tool, ooi):
        if found.T_cam_object is None or found.covariance is None:
            raise NoPoseError(f"{found.on} has no pose ({found.status.value}): {found.reason}")
    return pose_error(
        _given(tool.T_cam_object), _given(ooi.T_cam_object), T_ooi_goal, _given(tool.covariance), _given(ooi.covariance)
    )


def _given(array: Array | None) -> Array:
    if array is None:
        raise NoPoseError("pose without an array")
    return array
