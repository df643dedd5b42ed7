"""Whether the joint estimate may be believed: every look and every run by itself, not their mean.

A pool hides a contradiction: two looks at an object that was moved between them are 24 numbers against 200 of a path
that fits, and a path's scatter is what its own residuals say. So each is judged alone, and what is left over widens
the covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from server.calibration.contracts import Array, CalibrationStatus
from server.calibration.joint_lens import N_LENS

CHI2_CONFIDENCE = 0.999  # a sound look in a thousand is refused by chance
LOOK_FREEDOMS, OOI_FREEDOMS = 12, 6  # of the looks together, as many go into where the OOI is
RUN_MISFIT_MAX = 2.0  # scatter is renewed until right within a third, so twice is neither that nor chance
PRIOR_CHI2_CONFIDENCE = 0.9999  # with a prior of 3 deg per axis: 14 deg from the machine file
CAMERA_PARAMETERS_DOF = 2 + N_LENS  # scale, clock, lens and prints
OUTLIERS_MAX_FRAC = 0.4


@dataclass(frozen=True, slots=True)
class FitResiduals:
    """What is left of each observation after the fit, whitened.

    look_chi2: of each look's 12 numbers. run_position, run_turn: mean square of each run's whitened positions, turns.
    run_spread: of each run's positions as they are, over the largest variance that a scatter is believed to have: above
    1 it is not scatter but a drift or a step, which whitening by neighbours would hide.
    weights: of each run's samples. mount_chi2 (3 freedoms), mount_rad: camera's rotation against its prior.
    camera_parameter_chi2: odometry's scale, clock and lens against theirs: a fit that bends these to explain the rest
    is refused.
    """

    look_chi2: Sequence[float]
    run_position: Sequence[float]
    run_turn: Sequence[float]
    run_spread: Sequence[float]
    weights: Sequence[Array]
    mount_chi2: float
    mount_rad: float
    camera_parameter_chi2: float

    @property
    def worst_mean_square(self) -> float:
        """The worst of all mean squares, about 1 or less where everything agrees."""
        freedoms = max(1, LOOK_FREEDOMS * len(self.look_chi2) - OOI_FREEDOMS)
        looks, seeing = sum(self.look_chi2) / freedoms, self.camera_parameter_chi2 / CAMERA_PARAMETERS_DOF
        return float(max(looks, seeing, *self.run_position, *self.run_turn, *self.run_spread, 0.0))


def fit_verdict(fitted: FitResiduals) -> tuple[CalibrationStatus, str]:
    """OK, or POOR_FIT with what contradicts what."""
    reason = (
        _look_misfit_reason(fitted.look_chi2)
        or _run_misfit_reason(fitted)
        or _mount_misfit_reason(fitted)
        or _camera_misfit_reason(fitted)
    )
    return (CalibrationStatus.POOR_FIT, reason) if reason else (CalibrationStatus.OK, "")


def covariance_widened_by_misfit(covariance: Array, misfit: float) -> Array:
    """The covariance times the misfit where that is above 1: what was not explained may be anywhere."""
    return 0.5 * max(1.0, misfit) * (covariance + covariance.T)


def _look_misfit_reason(look_chi2: Sequence[float]) -> str:
    together = _chi2_bound(LOOK_FREEDOMS * len(look_chi2) - OOI_FREEDOMS)
    cases = [
        (f"look {i + 1} of {len(look_chi2)}", chi2, _chi2_bound(LOOK_FREEDOMS)) for i, chi2 in enumerate(look_chi2)
    ]
    for what, value, limit in [*cases, ("all looks together", float(sum(look_chi2)), together)]:
        if not value <= limit:
            return (
                f"the observations contradict each other: {what} by chi2 {value:.0f} (limit {limit:.0f}); "
                "the object of interest was moved, something slipped, or machine or camera file is of another machine"
            )
    return ""


def _run_misfit_reason(fitted: FitResiduals) -> str:
    for what, values in (("positions", fitted.run_position), ("turns", fitted.run_turn)):
        for i, value in enumerate(values):
            if not value <= RUN_MISFIT_MAX:
                return (
                    f"calibration path {i + 1} of {len(values)} and the machine file contradict each other: misfit of "
                    f"its {what} {value:.1f} (limit {RUN_MISFIT_MAX:g}); check machine file, camera file and clocks"
                )
    outliers = float(np.mean(np.concatenate(fitted.weights) < 0.5)) if fitted.weights else 0.0
    if outliers > OUTLIERS_MAX_FRAC:
        return (
            f"{100 * outliers:.0f} % of the odometry's samples are outliers (limit {100 * OUTLIERS_MAX_FRAC:.0f} %); "
            "mask what moves in the picture, or drive more slowly"
        )
    return ""


def _mount_misfit_reason(fitted: FitResiduals) -> str:
    limit = float(chdtri(3, 1.0 - PRIOR_CHI2_CONFIDENCE))
    if fitted.mount_chi2 <= limit:
        return ""
    return (
        f"the camera stands {np.rad2deg(fitted.mount_rad):.0f} deg from the machine file (chi2 {fitted.mount_chi2:.0f} "
        f"against the allowed mount tolerance, limit {limit:.0f}); correct the mount in the machine file"
    )


def _camera_misfit_reason(fitted: FitResiduals) -> str:
    limit = float(chdtri(CAMERA_PARAMETERS_DOF, 1.0 - PRIOR_CHI2_CONFIDENCE))
    if fitted.camera_parameter_chi2 <= limit:
        return ""
    return (
        "looks and path agree only with a camera that differs from the camera file: lens, odometry scale and clock are "
        f"off by chi2 {fitted.camera_parameter_chi2:.0f} (limit {limit:.0f}); calibrate the camera again, and check "
        "its clock"
    )


def _chi2_bound(freedoms: int) -> float:
    return float(chdtri(freedoms, 1.0 - CHI2_CONFIDENCE))
