"""What a hand-eye calibration takes and gives."""

from dataclasses import dataclass

import numpy as np

from server.calibration.contracts import Array, CalibrationStatus


@dataclass(frozen=True, slots=True)
class HandEyeSettings:
    """How the fit is made and what it refuses."""

    poses_min: int = 12  # fewer can be fitted exactly two by two, and say too small a covariance
    axis_spread_min_rad: float = float(np.deg2rad(2.0))  # rms rotation about the second strongest axis
    freedom: float = 5.0  # of Student's t, the residuals' distribution: heavy tails, outliers fade
    iterations_max: int = 60
    triples: int = 200  # random starts from three poses each
    residual_relative_max: float = 0.25  # median residual over the size of the motion, rotation and translation
    # medians; a target's pose is known to about 1 deg and 10 mm, encoders and clock add as much
    residual_rotation_max_rad: float = float(np.deg2rad(3.0))
    residual_translation_max_m: float = 0.03
    sigma_rotation_max_rad: float = float(np.deg2rad(5.0))
    sigma_translation_max_m: float = 0.1
    offset_bound_s: float = 0.25
    offset_grid_s: float = 0.01
    gap_max_s: float = 0.2  # hand poses further apart are not interpolated


@dataclass(frozen=True, slots=True)
class HandEyeEstimate:
    """A X = Y B solved: X (hand from camera), Y (base from target), None unless status is OK.

    `covariance` (12, 12): of X and Y, each rotation vector [rad] (left perturbation) then translation [m]; (6, 6) of X
    alone when only motions were given (Y is None then). `time_offset_s`: add to the camera's time to get the hand's.
    `scale`: length as the camera measures it over the true one. `axis_spread_rad`: see the settings.
    """

    status: CalibrationStatus
    reason: str
    X: Array | None
    Y: Array | None
    covariance: Array | None
    residual_median_deg: float
    residual_median_mm: float
    n_used: int
    axis_spread_rad: float
    scale: float = 1.0
    time_offset_s: float = 0.0
    time_offset_sigma_s: float = 0.0


def refused(status: CalibrationStatus, reason: str, n: int = 0, spread: float = 0.0) -> HandEyeEstimate:
    """An estimate without a pose."""
    nan = float("nan")
    return HandEyeEstimate(status, reason, None, None, None, nan, nan, n, spread)
