"""When both eyes and the layout leave two orientations, the last moments may decide between them."""

from dataclasses import dataclass

import numpy as np

from machine.rotations import rotvec_from_rotation
from server.vision.contracts import Array, ObjectPose, PoseStatus

AGE_MAX_S = 0.5
PLAUSIBLE_CHI2 = 16.8  # 6 degrees of freedom, 99 %


@dataclass(frozen=True, slots=True)
class PosePrior:
    """Where the object was in the camera a moment ago, by images alone.

    T_cam_object (4, 4); covariance (6, 6) rotation vector [rad], translation [m]; age_s: how long ago; ambiguous: that
    pose was not sure of its own orientation, or was itself chosen by time: it is then not used.
    """

    T_cam_object: Array
    covariance: Array
    age_s: float
    ambiguous: bool = False


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """One sigma of how fast the object may move and turn against the camera."""

    speed_m_s: float = 0.15
    turn_rate_rad_s: float = 0.15


def prior_from(found: ObjectPose, age_s: float) -> PosePrior | None:
    """The prior that a pose of an earlier pair makes; None where it may not count.

    A pose with a reason (ambiguous, or chosen by time) makes none: otherwise a wrong choice would pass itself on.
    """
    if found.T_cam_object is None or found.covariance is None:
        return None
    ambiguous = found.status is not PoseStatus.OK or found.reason != ""
    return None if ambiguous else PosePrior(found.T_cam_object, found.covariance, age_s)


def usable_prior(prior: PosePrior | None) -> bool:
    """Whether a prior may take part in a choice."""
    return prior is not None and not prior.ambiguous and 0.0 <= prior.age_s <= AGE_MAX_S


def chi2_to_prior(T_cam_object: Array, covariance: Array, prior: PosePrior, limits: MotionLimits) -> float:
    """How many chi2 (6 degrees of freedom) a pose lies from the prior, plausible motion allowed for."""
    turn = rotvec_from_rotation(T_cam_object[:3, :3] @ prior.T_cam_object[:3, :3].T)
    apart = np.concatenate([turn, T_cam_object[:3, 3] - prior.T_cam_object[:3, 3]])
    motion = np.repeat([limits.turn_rate_rad_s * prior.age_s, limits.speed_m_s * prior.age_s], 3)
    return float(apart @ np.linalg.solve(covariance + prior.covariance + np.diag(motion**2), apart))
