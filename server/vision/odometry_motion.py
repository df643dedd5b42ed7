"""Motion between pairs: prediction, and the covariance of the inverse pose."""

import numpy as np

from machine.poses import pose
from machine.rotations import rotation_from_rotvec, rotvec_from_rotation, skew
from server.vision.contracts import Array

RATIO_MAX = 4.0  # a longer gap than this many steps is no continuation


def predict_pose(T_vo_cam: Array, step: Array, step_ns: int, elapsed_ns: int) -> Array:
    """T_vo_cam after `elapsed_ns` if the last motion goes on; the same pose where the times make no sense.

    Args:    T_vo_cam: last pose. step: last motion T_before_last, which took step_ns.
    """
    ratio = elapsed_ns / step_ns if step_ns > 0 and elapsed_ns > 0 else 0.0
    if ratio > RATIO_MAX:
        ratio = 0.0
    rotation = rotation_from_rotvec(ratio * rotvec_from_rotation(step[:3, :3]))
    return T_vo_cam @ pose(rotation, ratio * step[:3, 3])


def covariance_in_vo(T_cam_vo: Array, covariance: Array) -> Array:
    """Covariance of T_vo_cam from that of its inverse.

    Model:   R <- exp(w) R, t <- t + dt of T_cam_vo gives T_vo_cam the left perturbation -R^T w and the translation
             -R^T (dt + [t]x w).
    Args:    T_cam_vo (4, 4); covariance (6, 6) of (w, dt) in camera axes.
    Returns: (6, 6), rotation [rad] then translation [m], in vo axes.
    """
    R_vo_cam = T_cam_vo[:3, :3].T
    J = np.zeros((6, 6))
    J[:3, :3] = -R_vo_cam
    J[3:, :3] = -R_vo_cam @ skew(T_cam_vo[:3, 3])
    J[3:, 3:] = -R_vo_cam
    return J @ covariance @ J.T


def with_scale_error(covariance: Array, position_vo: Array, sigma_scale_frac: float) -> Array:
    """Covariance (6, 6) with the rig's unknown scale: sigma_scale times the way from the start, along that way."""
    grown = covariance.copy()
    grown[3:, 3:] += sigma_scale_frac**2 * np.outer(position_vo, position_vo)
    return grown
