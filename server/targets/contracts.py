"""What the target package hands out: a measured patch, the anchored target, and the limits of both."""

from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array, Image

NAN = float("nan")


class PatchStatus(Enum):
    """Whether a surface patch may become a target; every other member than OK is a refusal."""

    OK = "ok"
    OUTSIDE_IMAGE = "outside_image"
    GLARE = "glare"
    NO_TEXTURE = "no_texture"
    NOT_IN_BOTH_EYES = "not_in_both_eyes"
    REPEATED_TEXTURE = "repeated_texture"
    DEPTH_EDGE = "depth_edge"
    TOO_OBLIQUE = "too_oblique"
    TOO_FAR = "too_far"
    NO_SURROUNDINGS = "no_surroundings"


@dataclass(frozen=True, slots=True)
class TargetSettings:
    """Limits of a target; normal_max_deg and position_max_m: of the 95 % uncertainty at the largest radius."""

    radii_m: tuple[float, ...] = (0.03, 0.045, 0.06, 0.08, 0.1, 0.13)  # of the patch, tried in turn until ...
    normal_wanted_deg: float = 0.8  # ... its normal is known so well: a move's 1 deg is two sigma, tool and camera too
    normal_max_deg: float = 2.0
    position_max_m: float = 0.004  # leaves the rest of a move's 5 mm to tool and motion
    oblique_max_deg: float = 60.0  # foreshortened to half, which also halves the texture that can be matched
    clipped_max_frac: float = 0.05  # of the pixels; clipped ones cannot be measured
    depth_min_m: float = 0.25  # range of the stereo search along the epipolar line
    depth_max_m: float = 3.0
    sigma_px: float = 0.05  # of one aligned coordinate of a landmark: docs/vision.md, odometry alignment
    sigma_floor_px: float = 0.02  # what interpolation leaves of a disparity without noise; in part alike in a patch
    sigma_disparity_px: float = 0.1  # bias left after camera calibration, the prior of the lens model
    surroundings_m: float = 0.4  # radius of the landmarks around the target
    sigma_frame_rad: float = float(np.deg2rad(0.1))  # turn of the teaching markers' frame: the layout prior


@dataclass(frozen=True, slots=True)
class SurfacePatch:
    """The surface around one pixel of the left image.

    T_cam_target (4, 4): origin on the surface at the pixel; z along the outward normal, x to the right of the image, y
    up. covariance (6, 6): rotation vector [rad] (left perturbation, camera axes), then translation [m]; measurement
    noise only. Both are None when refused. samples_px (n, 2): raw left pixels that were measured; samples_cam (n, 3):
    their places on the fitted surface [m]. n_used: samples that lie on the surface.
    """

    status: PatchStatus
    reason: str
    pixel: tuple[float, float]
    T_cam_target: Array | None
    covariance: Array | None
    samples_px: Array
    samples_cam: Array
    radius_m: float
    surface_shape: Literal["plane", "curved"]
    n_used: int
    residual_px: float

    @property
    def ok(self) -> bool:
        """Whether the patch was measured."""
        return self.status is PatchStatus.OK


def refused_patch(status: PatchStatus, reason: str, pixel: tuple[float, float]) -> SurfacePatch:
    """A patch that could not be measured, with its reason."""
    none = np.zeros((0, 2))
    return SurfacePatch(status, reason, pixel, None, None, none, np.zeros((0, 3)), 0.0, "plane", 0, NAN)


@dataclass(frozen=True, slots=True)
class Landmarks:
    """Points of the reference pair: raw pixels (n, 2) of both eyes, places in target axes (n, 3) [m] and their
    covariances (n, 3, 3) [m^2]. support_target (n, 2, 3): where one raw left pixel to the right and below meets the
    surface, in target axes.
    """

    left_px: Array
    right_px: Array
    points_target: Array
    covariances_target: Array
    support_target: Array

    def __len__(self) -> int:
        return len(self.left_px)

    def subset(self, chosen: "BoolArray") -> "Landmarks":
        """Only these landmarks."""
        arrays = (self.left_px, self.right_px, self.points_target, self.covariances_target, self.support_target)
        return Landmarks(*(array[chosen] for array in arrays))


@dataclass(frozen=True, slots=True)
class AnchoredTarget:
    """A target with all that is needed to find it again.

    reference_left, reference_right: the raw grey pair (h, w) it was measured in. T_ref_target (4, 4): target in the
    left camera there. covariance_target (6, 6): of the anchored pose against the true surface, target axes,
    as SurfacePatch.
    sigma_scale_frac: what a disparity bias s does to all distances at the reference range Z, s Z / (f B), one sigma.
    """

    target_id: int
    patch: SurfacePatch
    T_ref_target: Array
    covariance_target: Array
    sigma_scale_frac: float
    reference_left: Image
    reference_right: Image
    surrounding_landmarks: Landmarks
    surface_landmarks: Landmarks

    @property
    def reference_images(self) -> tuple[Image, Image]:
        """Both eyes' reference images."""
        return self.reference_left, self.reference_right


@dataclass(frozen=True, slots=True)
class TargetFix:
    """Where the target is in one pair, or why that is not known.

    agree_frac: share of the visible patch samples that agree; NaN when the own tool covers the patch.
    """

    ok: bool
    reason: str
    T_cam_target: Array | None
    covariance: Array | None
    n_landmarks: int
    agree_frac: float
    residual_px: float
    surroundings_seen: bool = True  # False: nothing of the surroundings was recognised


def no_fix(reason: str, n: int, share: float = NAN, residual_px: float = NAN, seen: bool = True) -> TargetFix:
    """Why there is no pose, from n landmarks."""
    return TargetFix(False, reason, None, None, n, share, residual_px, seen)


BoolArray = NDArray[np.bool_]
