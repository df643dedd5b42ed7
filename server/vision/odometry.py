"""Stereo odometry: each pair is laid onto kept keyframes, oldest first, so that a revisited place costs no drift."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose
from machine.rotations import nearest_rotation
from server.vision.contracts import Array, Image, OdometryPose, OdometryStatus
from server.vision.odometry_features import allowed_mask, coverage, inside_mask
from server.vision.odometry_flow import flow
from server.vision.odometry_keyframe import Keyframe, make_keyframe, match_eyes
from server.vision.odometry_motion import covariance_in_vo, predict_pose, with_scale_error
from server.vision.odometry_observation import Frame, Observed, observe_map
from server.vision.odometry_pose import PoseFit, coarse_pose, refine_camera
from server.vision.warm_up import warm_up_odometry

UNKNOWN_COVARIANCE = np.diag([np.pi**2] * 3 + [1e6] * 3)
COARSE_ALIGNED_MIN_FRAC = 0.1  # after a coarse start: it has RANSAC behind it
INLIERS_MIN_FRAC = 0.5


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """How much is tracked, and when the result is believed."""

    features: int = 400  # grid cells for new corners, one corner each
    points_max: int = 320  # map points laid onto each pair
    sigma_px: float = 0.12  # of one aligned coordinate
    aligned_min_frac: float = 0.5  # of the expected points; below, the prediction was wrong and flow must help
    keyframe_below_frac: float = 0.55  # of the last keyframe's points or coverage
    keyframes_max: int = 40
    inliers_good: int = 60
    inliers_min: int = 15
    coverage_good: int = 10  # of 40 cells of the image
    sigma_scale_frac: float = 0.004  # of the rig's calibration: 0.2 px of disparity at 1.3 m; no pair can show it


@dataclass(frozen=True, slots=True)
class Last:
    """The last pair whose pose is known, and its inliers: the start for the next one."""

    frame: Frame
    T_vo_cam: Array
    step: Array  # motion since the pair before, T_before_last
    step_ns: int
    left_px: Array
    points_vo: Array


class StereoOdometry:
    """Pairs in, poses of the left camera in `vo` out; `vo` is the left camera of the first pair after a reset."""

    def __init__(self, camera: StereoCamera, settings: OdometrySettings | None = None) -> None:
        self._camera = camera
        self._shape = (camera.height_px, camera.width_px)
        self._settings = settings or OdometrySettings()
        self._keyframes: list[Keyframe] = []
        self._last: Last | None = None
        self._full_points = 0
        self._full_coverage = 0
        warm_up_odometry()

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """The kept keyframes, the anchor first."""
        return tuple(self._keyframes)

    def reset(self) -> None:
        """Forget everything; the next pair starts a new `vo` frame."""
        self._keyframes = []
        self._last = None

    def process(
        self,
        left: Image,
        right: Image,
        t_exposure_ns: int,
        mask_polygons_left: Sequence[Array] = (),
        mask_polygons_right: Sequence[Array] = (),
    ) -> OdometryPose:
        """Pose of the left camera at this exposure.

        Model:   predict by the last motion; align patches of the oldest keyframes that still see enough; if too few
                 fit, flow from the last pair and PnP-RANSAC give a better start; robust two-view fit over all points.
        Args:    left, right: raw grey (h, w). Mask polygons (k, 2) [raw px]: what is not part of the wall (the tool).
        Returns: OdometryPose; covariance by left perturbation in vo axes, then translation. While LOST the last pose
                 stays and its covariance says that nothing is known.
        """
        if any(image.shape != self._shape or image.dtype != np.uint8 for image in (left, right)):
            found = f"{left.shape} {left.dtype} and {right.shape} {right.dtype}"
            return self._lost(t_exposure_ns, f"pair is {found}; the camera file says {self._shape} uint8")
        masks = allowed_mask(self._shape, mask_polygons_left), allowed_mask(self._shape, mask_polygons_right)
        frame = Frame(left, right, masks, t_exposure_ns)
        if self._last is None:
            return self._start(frame)
        fitted = self._locate(frame, self._last)
        if fitted is None:
            return self._lost(
                t_exposure_ns, "too few known points found again; go back to where they were or start anew"
            )
        return self._accept(frame, self._last, *fitted)

    def _start(self, frame: Frame) -> OdometryPose:
        keyframe = self._add_keyframe(frame, np.eye(4), np.zeros((6, 6)), np.zeros((0, 2)))
        if keyframe.n_points < self._settings.inliers_min:
            self.reset()
            reason = f"{keyframe.n_points} points in both eyes (need {self._settings.inliers_min}); too little texture"
            return self._lost(frame.t_exposure_ns, reason)
        self._last = Last(frame, np.eye(4), np.eye(4), 0, keyframe.places_left_px, keyframe.points_vo)
        status, reason = self._verdict(keyframe.places_left_px)
        return OdometryPose(frame.t_exposure_ns, np.eye(4), np.zeros((6, 6)), status, reason, keyframe.n_points)

    def _locate(self, frame: Frame, last: Last) -> tuple[Observed, PoseFit] | None:
        elapsed_ns = frame.t_exposure_ns - last.frame.t_exposure_ns
        predicted = predict_pose(last.T_vo_cam, last.step, last.step_ns, elapsed_ns)
        fitted = self._fit(frame, predicted, self._settings.aligned_min_frac)
        if fitted is not None:
            return fitted
        T_coarse = self._coarse(frame, last)
        return None if T_coarse is None else self._fit(frame, T_coarse, COARSE_ALIGNED_MIN_FRAC)

    def _coarse(self, frame: Frame, last: Last) -> Array | None:
        """T_vo_cam from flow: from the last pair, else from the first and the newest keyframe."""
        sources = [(last.frame.left, last.left_px, last.points_vo)]
        for keyframe in (self._keyframes[0], self._keyframes[-1]):
            sources.append((keyframe.left, keyframe.places_left_px, keyframe.points_vo))
        for image, places_px, points_vo in sources:
            found = flow(image, frame.left, places_px)
            good = found.good & inside_mask(frame.masks[0], found.points_px)
            rays = undistort_to_rays(self._camera, found.points_px[good])
            start = coarse_pose(points_vo[good], rays, self._camera.fx_px)
            if start is not None and start.n_inliers >= self._settings.inliers_min:
                return inverse_pose(start.T_cam_vo)
        return None

    def _fit(self, frame: Frame, T_vo_cam: Array, aligned_min_frac: float) -> tuple[Observed, PoseFit] | None:
        settings = self._settings
        observed = observe_map(self._camera, self._keyframes, frame, T_vo_cam, settings.points_max, settings.sigma_px)
        if len(observed.left_px) < max(aligned_min_frac * observed.n_expected, settings.inliers_min):
            return None
        fit = refine_camera(inverse_pose(T_vo_cam), observed.seen)
        if fit is None or fit.inliers.sum() < max(settings.inliers_min, INLIERS_MIN_FRAC * len(fit.inliers)):
            return None
        return observed, fit

    def _accept(self, frame: Frame, last: Last, observed: Observed, fit: PoseFit) -> OdometryPose:
        T_vo_cam = inverse_pose(fit.T_cam_vo)
        T_vo_cam[:3, :3] = nearest_rotation(T_vo_cam[:3, :3])
        inliers_px = observed.left_px[fit.inliers]
        covariance = covariance_in_vo(fit.T_cam_vo, fit.covariance) + self._anchor_covariance(observed, fit)
        status, reason = self._verdict(inliers_px)
        self._last = Last(
            frame=frame,
            T_vo_cam=T_vo_cam,
            step=inverse_pose(last.T_vo_cam) @ T_vo_cam,
            step_ns=frame.t_exposure_ns - last.frame.t_exposure_ns,
            left_px=inliers_px,
            points_vo=observed.seen.points_vo[fit.inliers],
        )
        if self._wants_keyframe(inliers_px):
            self._add_keyframe(frame, T_vo_cam, covariance, inliers_px)
        reported = with_scale_error(covariance, T_vo_cam[:3, 3], self._settings.sigma_scale_frac)
        return OdometryPose(frame.t_exposure_ns, T_vo_cam, reported, status, reason, len(inliers_px))

    def _anchor_covariance(self, observed: Observed, fit: PoseFit) -> Array:
        """The keyframes' own covariance, weighted by how many inliers each gave."""
        numbers, counts = np.unique(observed.keyframes[fit.inliers], return_counts=True)
        weighted = [self._keyframes[number].covariance * count for number, count in zip(numbers, counts, strict=True)]
        return np.sum(weighted, axis=0) / counts.sum()

    def _verdict(self, inliers_px: Array) -> tuple[OdometryStatus, str]:
        settings = self._settings
        count, covered = len(inliers_px), coverage(inliers_px, self._shape)
        if count < settings.inliers_good:
            return OdometryStatus.DEGRADED, f"{count} points (good from {settings.inliers_good}); little texture"
        if covered < settings.coverage_good:
            limit = settings.coverage_good
            return OdometryStatus.DEGRADED, f"points in {covered} of 40 cells of the image (good from {limit})"
        return OdometryStatus.OK, ""

    def _wants_keyframe(self, inliers_px: Array) -> bool:
        frac = self._settings.keyframe_below_frac
        few = len(inliers_px) < frac * self._full_points
        return few or coverage(inliers_px, self._shape) < frac * self._full_coverage

    def _add_keyframe(self, frame: Frame, T_vo_cam: Array, covariance: Array, occupied_px: Array) -> Keyframe:
        camera, settings = self._camera, self._settings
        found = match_eyes(camera, frame.left, frame.right, frame.masks, settings.features, occupied_px)
        images = frame.left.copy(), frame.right.copy()
        keyframe = make_keyframe(camera, images, (T_vo_cam, covariance), found, settings.sigma_px)
        self._keyframes.append(keyframe)
        if len(self._keyframes) > settings.keyframes_max:
            del self._keyframes[1]  # the first is the anchor of the whole track
        everything = np.concatenate([occupied_px, keyframe.places_left_px])
        self._full_points = min(len(everything), settings.points_max)
        self._full_coverage = coverage(everything, self._shape)
        return keyframe

    def _lost(self, t_exposure_ns: int, reason: str) -> OdometryPose:
        T_vo_cam = np.eye(4) if self._last is None else self._last.T_vo_cam
        return OdometryPose(t_exposure_ns, T_vo_cam, UNKNOWN_COVARIANCE.copy(), OdometryStatus.LOST, reason, 0)
