"""Two opinions about one rotation, joined by their covariances."""

from dataclasses import dataclass

import numpy as np

from machine.rotations import rotation_from_rotvec, rotvec_from_rotation
from server.calibration.checks import require_covariance, require_rotation
from server.calibration.contracts import Array, MountRotation


@dataclass(frozen=True, slots=True)
class FusedRotation:
    """The joined rotation and how well the two agreed: `chi2` of their difference, 3 degrees of freedom."""

    mount: MountRotation
    chi2: float
    inflated: bool


def prior_from_tool_marker(R_tcp_tool: Array, R_cam_tool: Array, sigma_rad: float) -> MountRotation:
    """The camera's mounting as the tool marker in the image shows it.

    Model:   R_tcp_cam = R_tcp_tool R_cam_tool^T; its error is that of the marker's own mounting on the tool.
    Args:    R_tcp_tool: nominal tool marker mounting (3, 3); R_cam_tool: as seen (3, 3); sigma_rad: of the mounting,
             each axis [rad], > 0.
    Returns: mounting with covariance sigma^2 I.
    Raises:  CalibrationInputError: no rotation.
    """
    R = require_rotation(R_tcp_tool, "R_tcp_tool") @ require_rotation(R_cam_tool, "R_cam_tool").T
    return MountRotation(R_tcp_cam=R, covariance=require_covariance(sigma_rad**2 * np.eye(3), 3, "sigma_rad^2 I"))


def fuse_rotations(data: MountRotation, prior: MountRotation, chi2_max: float = 16.3) -> FusedRotation:
    """Joint rotation of two independent estimates, in information form.

    Model:   d = log(R_prior R_data^T); P = (P_data^-1 + P_prior^-1)^-1; R = exp(P P_prior^-1 d) R_data. When d is
             improbable (chi2 = d^T (P_data + P_prior)^-1 d > chi2_max, 16.3 is 99.9 %), P is inflated by chi2 / 3.
    Args:    data, prior: covariance (3, 3) [rad^2], left perturbation, TCP axes.
    Returns: the joint mounting, its covariance, and the agreement.
    """
    d = rotvec_from_rotation(prior.R_tcp_cam @ data.R_tcp_cam.T)
    information_prior = np.linalg.inv(prior.covariance)
    P = np.linalg.inv(np.linalg.inv(data.covariance) + information_prior)
    P = 0.5 * (P + P.T)
    R = rotation_from_rotvec(P @ information_prior @ d) @ data.R_tcp_cam
    chi2 = float(d @ np.linalg.solve(data.covariance + prior.covariance, d))
    inflated = chi2 > chi2_max
    return FusedRotation(MountRotation(R, P * (chi2 / 3.0) if inflated else P), chi2, inflated)
