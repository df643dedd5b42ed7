"""How much is tracked, and from when on a pose of the odometry is believed."""

from dataclasses import dataclass

import numpy as np

from server.vision.contracts import Array, OdometryStatus
from server.vision.odometry_features import covered_cell_count

REFERENCE_IMAGE_AREA_PX2 = 1280 * 720  # `inliers_good` is of such a picture; a smaller one has room for fewer corners


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """How much is tracked, and when the result is believed."""

    corner_cells: int = 400  # grid cells for new corners, one corner each
    points_max: int = 320  # map points laid onto each pair
    sigma_px: float = 0.08  # of one coordinate of a corner in one image
    aligned_min_frac: float = 0.5  # of the expected points; below, the prediction was wrong and flow must help
    keyframe_below_frac: float = 0.55  # of the last keyframe's points or coverage
    keyframes_max: int = 40
    window_keyframes: int = 6  # newest keyframes that are adjusted together when one is added
    inliers_good: int = 60
    inliers_min: int = 15
    coverage_good: int = 10  # of 40 cells of the image
    right_good_frac: float = 0.5  # of the points that lie in the right eye's view
    sigma_good_m: float = 2e-3  # of the position, the rig's scale apart, near the start
    sigma_good_frac: float = 0.005  # of the distance from the start, added to that
    rms_good: float = 6.0  # of the residuals in their sigmas; photographs of a street reach 3.5
    texture_good_grey: float = 9.0  # variation of grey about a typical point; three times a camera's noise
    sigma_scale_frac: float = 0.004  # of the rig's calibration: 0.2 px of disparity at 1.3 m; no pair can show it
    readout_s: float | None = None  # rolling shutter, first to last row; 0 = global; None = learned from the motion

    def count_good(self, shape: tuple[int, int]) -> int:
        """From how many points on a pose is good, in pictures of this height and width."""
        share = min(1.0, shape[0] * shape[1] / REFERENCE_IMAGE_AREA_PX2)
        return max(self.inliers_min, round(self.inliers_good * share))


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a pose rests on: its inliers' raw left pixels (n, 2), covariance (6, 6) without the rig's scale, residuals
    in their sigmas, distance from the start, share of the points that the right eye shows, variation of grey about
    points, why the covariance is as wide as it is ("": nothing special), and whether no other disparity fits."""

    inliers_px: Array
    covariance: Array
    rms_sigma: float
    texture_grey: float
    distance_m: float = 0.0
    right_frac: float = 1.0
    doubt_reason: str = ""
    unique_depth: bool = True


def odometry_verdict(settings: OdometrySettings, shape: tuple[int, int], found: Evidence) -> tuple[OdometryStatus, str]:
    """OK, or DEGRADED and why; `shape` of a picture, height first."""
    good_m = settings.sigma_good_m + settings.sigma_good_frac * found.distance_m
    count, covered, wanted = (
        len(found.inliers_px),
        covered_cell_count(found.inliers_px, shape),
        settings.count_good(shape),
    )
    sigma_m = float(np.sqrt(max(np.linalg.eigvalsh(found.covariance[3:, 3:])[-1], 0.0)))
    reason = ""
    if count < wanted:
        reason = f"{count} points (good from {wanted}); little texture, or something covers the wall"
    elif not found.unique_depth:
        reason = "texture repeats along the rows: depth and scale may be quite others; turn the camera, or go nearer"
    elif found.texture_grey < settings.texture_good_grey:
        reason = (
            f"texture is faint: grey varies by {found.texture_grey:.1f} levels (good from "
            f"{settings.texture_good_grey:g}); more light, or go nearer"
        )
    elif covered < settings.coverage_good:
        reason = f"points in {covered} of 40 cells of the image (good from {settings.coverage_good})"
    elif found.right_frac < settings.right_good_frac:
        reason = (
            f"the right eye shows {100 * found.right_frac:.0f} % of the known points that it should (good from "
            f"{100 * settings.right_good_frac:.0f} %); covered, frozen, out of step, or the eyes are swapped"
        )
    elif sigma_m > good_m:
        why = found.doubt_reason or "go slower or nearer"
        reason = f"position only known to {1e3 * sigma_m:.1f} mm (good to {1e3 * good_m:.1f}); {why}"
    elif found.rms_sigma > settings.rms_good:
        reason = (
            f"points disagree {found.rms_sigma:.1f} times more than they should; calibration, sync or moving things"
        )
    return (OdometryStatus.DEGRADED if reason else OdometryStatus.OK), reason
