"""What a pair shows of the map: patches of the keyframes, the oldest first, laid onto it until there are enough."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from server.vision.contracts import Array, Image
from server.vision.odometry_align import align
from server.vision.odometry_features import inside_mask
from server.vision.odometry_keyframe import Keyframe, expect_points
from server.vision.odometry_pose import StereoPoints


@dataclass(frozen=True, slots=True)
class Frame:
    """One stereo pair with the masks of where points may lie."""

    left: Image
    right: Image
    masks: tuple[Image, Image]
    t_exposure_ns: int


@dataclass(frozen=True, slots=True)
class Observed:
    """Map points found in a pair: the keyframe of each (n,), its raw pixels in the left eye, numbers for the fit."""

    keyframes: NDArray[np.int64]
    left_px: Array
    n_expected: int
    seen: StereoPoints


@dataclass(frozen=True, slots=True)
class _Part:
    """What one keyframe contributes; right_px is NaN where the right eye does not show the point."""

    keyframes: NDArray[np.int64]
    points_vo: Array
    left_px: Array
    right_px: Array
    sigma_px: Array


def observe_map(
    camera: StereoCamera, keyframes: Sequence[Keyframe], frame: Frame, T_vo_cam: Array, points_max: int, sigma_px: float
) -> Observed:
    """Map points in a pair taken near `T_vo_cam`.

    Model:   variance of a coordinate = alignment + its depth error + its keyframe's position error, all in px.
    Args:    keyframes: oldest first. points_max: no further keyframe once this many points were expected.
             sigma_px: of one aligned coordinate.
    """
    parts = []
    n_expected = 0
    for number, keyframe in enumerate(keyframes):
        part, expected = _observe_keyframe(camera, number, keyframe, frame, T_vo_cam, sigma_px)
        parts.append(part)
        n_expected += expected
        if n_expected >= points_max:
            break
    left_px = np.concatenate([part.left_px for part in parts])
    seen = StereoPoints(
        points_vo=np.concatenate([part.points_vo for part in parts]),
        rays_left=undistort_to_rays(camera, left_px),
        rays_right=_rays_or_nan(camera, np.concatenate([part.right_px for part in parts])),
        sigma_px=np.concatenate([part.sigma_px for part in parts]),
        focal_px=camera.fx_px,
        baseline_m=camera.baseline_m,
    )
    return Observed(np.concatenate([part.keyframes for part in parts]), left_px, n_expected, seen)


def _observe_keyframe(
    camera: StereoCamera, number: int, keyframe: Keyframe, frame: Frame, T_vo_cam: Array, sigma_px: float
) -> tuple[_Part, int]:
    expected = expect_points(camera, keyframe, T_vo_cam, frame.masks[0])
    on = expected.indices
    left = align(keyframe.left, keyframe.places_left_px[on], expected.warps, frame.left, expected.left_px)
    right = align(keyframe.right, keyframe.places_right_px[on], expected.warps, frame.right, expected.right_px)
    keyframe.failures[on] = np.maximum(keyframe.failures[on] + np.where(left.good, -1, 1), 0)
    right_good = right.good & inside_mask(frame.masks[1], right.points_px)
    good = left.good
    variance = sigma_px**2 + expected.map_sigma_px[good] ** 2 + keyframe_sigma_px(camera, keyframe) ** 2
    part = _Part(
        keyframes=np.full(int(good.sum()), number, dtype=np.int64),
        points_vo=keyframe.points_vo[on[good]],
        left_px=left.points_px[good],
        right_px=np.where(right_good[:, None], right.points_px, np.nan)[good],
        sigma_px=np.sqrt(variance),
    )
    return part, len(on)


def keyframe_sigma_px(camera: StereoCamera, keyframe: Keyframe) -> float:
    """What a keyframe's own position sigma amounts to in the image: older, better known keyframes weigh more."""
    if keyframe.n_points == 0:
        return 0.0
    depth = float(np.median(np.linalg.norm(keyframe.points_vo - keyframe.T_vo_cam[:3, 3], axis=1)))
    return float(np.sqrt(np.trace(keyframe.covariance[3:, 3:]) / 3.0) * camera.fx_px / max(depth, 0.1))


def _rays_or_nan(camera: StereoCamera, pixels: Array) -> Array:
    rays = np.full_like(pixels, np.nan)
    known = ~np.isnan(pixels[:, 0])
    rays[known] = undistort_to_rays(camera, pixels[known])
    return rays
