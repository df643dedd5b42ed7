"""What is left to the goal: tool minus goal in OOI axes, with one sigma of everything."""

from dataclasses import dataclass

import numpy as np

from machine.poses import inverse_pose
from machine.rotations import rotvec_from_rotation, skew
from server.vision.contracts import Array, Look, ObjectPose
from server.vision.errors import NoPoseError


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
    T_cam_tool: Array,
    T_cam_ooi: Array,
    T_ooi_goal: Array,
    tool_covariance: Array,
    ooi_covariance: Array,
    common: Array | None = None,
) -> PoseError:
    """Error of the tool against the goal in OOI axes, first-order sigmas.

    Model:   p = R_o^T (t_t - t_o) - p_goal; rotvec = log(R_o^T R_t R_goal^T). With left perturbations w in camera axes:
             dp = R_o^T (dt_t - dt_o + [t_t - t_o]x w_o), drotvec = R_o^T (w_t - w_o) for a small error.
    Args:    poses (4, 4) in the left camera; covariances (6, 6), rotation [rad] then position [m]. common: covariance
             (12, 12) of tool, then OOI, from what all pairs share (lens, prints, layout): no mean shrinks it, and what
             moves both alike cancels.
    Returns: PoseError.
    """
    T_ooi_tool = inverse_pose(T_cam_ooi) @ T_cam_tool
    both = np.zeros((12, 12)) if common is None else common.copy()
    both[:6, :6] += tool_covariance
    both[6:, 6:] += ooi_covariance
    covariance = pose_error_covariance(T_cam_tool, T_cam_ooi, both)
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


def pose_error_covariance(T_cam_tool: Array, T_cam_ooi: Array, look_covariance: Array) -> Array:
    """Covariance (6, 6) of the error, position [m] then rotation [rad], from a look's (12, 12): tool, then OOI."""
    J = error_jacobian(T_cam_tool, T_cam_ooi)
    return J @ look_covariance @ J.T


def error_jacobian(T_cam_tool: Array, T_cam_ooi: Array) -> Array:
    """d error / d look (6, 12): position, then rotation in OOI axes, by tool, then OOI, rotation, then position."""
    R_ooi_cam = T_cam_ooi[:3, :3].T
    arm = T_cam_tool[:3, 3] - T_cam_ooi[:3, 3]
    J = np.zeros((6, 12))
    J[:3, 3:6], J[3:, :3] = R_ooi_cam, R_ooi_cam
    J[:3, 6:9], J[:3, 9:], J[3:, 6:9] = R_ooi_cam @ skew(arm), -R_ooi_cam, -R_ooi_cam
    return J


def _sigma_of_angle(rotvec: Array, covariance: Array) -> float:
    """Sigma along the error's own axis; the largest one where the error is too small to have an axis."""
    angle = float(np.linalg.norm(rotvec))
    largest = float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
    if angle < largest:
        return largest
    axis = rotvec / angle
    return float(np.sqrt(max(axis @ covariance @ axis, 0.0)))


def error_to_goal(look: Look, T_ooi_goal: Array, common: Array | None = None) -> PoseError:
    """Error of a look that has poses; `common` as in `pose_error`.

    Raises: NoPoseError when the look failed.
    """
    if look.T_cam_tool is None or look.T_cam_ooi is None or look.tool_covariance is None or look.ooi_covariance is None:
        raise NoPoseError(f"look {look.status.value} has no poses: {look.reason}; look again")
    covariances = look.tool_covariance, look.ooi_covariance
    return pose_error(look.T_cam_tool, look.T_cam_ooi, T_ooi_goal, *covariances, common)


def pair_error(tool: ObjectPose, ooi: ObjectPose, T_ooi_goal: Array, common: Array | None = None) -> PoseError:
    """Error in one pair, for display; `common` as in `pose_error`.

    Raises: NoPoseError when one of the objects has no pose.
    """
    (T_cam_tool, tool_covariance), (T_cam_ooi, ooi_covariance) = _pose_and_covariance(tool), _pose_and_covariance(ooi)
    return pose_error(T_cam_tool, T_cam_ooi, T_ooi_goal, tool_covariance, ooi_covariance, common)


def _pose_and_covariance(found: ObjectPose) -> tuple[Array, Array]:
    if found.T_cam_object is None or found.covariance is None:
        raise NoPoseError(f"{found.object_name} has no pose ({found.status.value}): {found.reason}")
    return found.T_cam_object, found.covariance
