"""Stereo odometry: each pair is laid onto kept keyframes, oldest first, so that a revisited place costs no drift."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machine.description import StereoCamera
from machine.poses import inverse_pose, pose_difference, transform_points
from machine.rotations import nearest_rotation
from server.vision.contracts import Array, Image, OdometryPose, OdometryStatus
from server.vision.odometry_adjustment import adjust_keyframes
from server.vision.odometry_covariance import KeyframeCovariances, readout_of
from server.vision.odometry_features import allowed_mask, covered_cell_count
from server.vision.odometry_keyframe import Keyframe, SeenHere, make_keyframe, wants_keyframe
from server.vision.odometry_motion import (
    Motion,
    Twist,
    covariance_in_vo,
    moved_by_twist,
    row_fractions,
    standing_motion,
    with_scale_error,
)
from server.vision.odometry_motions import LocatedPose, Scene, find_motions, part_motions, world_motion
from server.vision.odometry_observation import ObservedPoints, OwnStructure, expected_right, observe_map, vote_by_pair
from server.vision.odometry_place import best_place, by_flow, by_recognition, travel_limit_m
from server.vision.odometry_pose import PoseFit, pose_problem, rough_pose, settled_pose
from server.vision.odometry_sensitivity import Sensitivity, Shutter, fit_sensitivity
from server.vision.odometry_sight import ImageSight, Sight
from server.vision.odometry_verdict import Evidence, OdometrySettings, odometry_verdict
from server.vision.odometry_warm_up import warm_up

UNKNOWN_COVARIANCE = np.diag([np.pi**2] * 3 + [1e6] * 3)
COARSE_ALIGNED_MIN_FRAC = 0.1  # after a coarse start: it has RANSAC behind it
INLIERS_MIN_FRAC = 0.5


@dataclass(frozen=True, slots=True)
class LastLocatedPair:
    """The last pair whose pose is known, and its inliers: the start for the next one."""

    image_pair: Sight
    motion: Motion
    left_px: Array
    points_vo: Array
    is_keyframe: bool


class StereoOdometry:
    """Pairs in, poses of the left camera in `vo` out; `vo` is the left camera of the first pair after a reset."""

    def __init__(self, camera: StereoCamera, settings: OdometrySettings | None = None) -> None:
        self._camera = camera
        self._shape = (camera.height_px, camera.width_px)
        self._settings = settings or OdometrySettings()
        self.reset()
        warm_up()

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """The kept keyframes, the anchor first."""
        return tuple(self._keyframes)

    def on_own_structure(self, left_px: Array) -> NDArray[np.bool_]:
        """Which places (n, 2) [raw px] of the left picture were recognised as own structure so far."""
        return self._own.on_own_structure(left_px)

    def map_points(self, count_max: int) -> Array:
        """At most so many of the map's points (n, 3) in vo [m]: for looking at, not for measuring."""
        points_vo = np.vstack([np.zeros((0, 3)), *(keyframe.points_vo for keyframe in self._keyframes)])
        return points_vo[:: max(1, -(-len(points_vo) // count_max))]

    def reset(self) -> None:
        """Forget everything; the next pair starts a new `vo` frame."""
        self._keyframes: list[Keyframe] = []
        self._known = KeyframeCovariances()
        self._readout = readout_of(self._settings.readout_s)
        self._last: LastLocatedPair | None = None
        self._serial = 0
        self._recognitions = 0
        self._full_points = 0
        self._full_coverage = 0
        self._texture_grey = float("inf")
        self._unique_depth = True
        self._unsure_m = 0.0  # how far the camera may have come unseen, as long as its place may be another one
        height, width = self._shape
        self._own = OwnStructure(self._shape, int(np.sqrt(height * width / self._settings.corner_cells)))

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
                 fit, flow from the last pair and PnP-RANSAC give a better start; robust two-view fit over all points,
                 one for each motion in the picture, of which one is the world's (`odometry_motions.py`).
        Args:    left, right: raw grey (h, w). Mask polygons (k, 2) [raw px]: what is not part of the wall (the tool).
        Returns: OdometryPose; covariance by left perturbation in vo axes, then translation. While LOST the last pose
                 stays and its covariance says that nothing is known.
        """
        if any(image.shape != self._shape or image.dtype != np.uint8 for image in (left, right)):
            found = f"{left.shape} {left.dtype} and {right.shape} {right.dtype}"
            return self._lost(t_exposure_ns, f"pair is {found}; the camera file says {self._shape} uint8")
        masks = allowed_mask(self._shape, mask_polygons_left), allowed_mask(self._shape, mask_polygons_right)
        return self.process_sight(ImageSight(left, right, masks, t_exposure_ns))

    def process_sight(self, sight: Sight) -> OdometryPose:
        """As `process`, for a pair that was looked at in another way (a simulation of points)."""
        if self._last is None:
            return self._start(sight)
        located = self._locate_camera(sight, self._last)
        if located is None:
            reason = "too few known points found again: dark, covered, or a new place; go back or start again"
            return self._lost(sight.t_exposure_ns, reason)
        located = self._resolve_ambiguous_place(sight, self._last, located)
        if self._last.is_keyframe and not located.doubt_reason:
            located = self._settle_keyframe(sight, self._last, located)
        return self._accept_located_pose(sight, self._last, located)

    def _start(self, sight: Sight) -> OdometryPose:
        motion = standing_motion(np.eye(4), sight.t_exposure_ns)
        kept = sight.keep_copy()
        keyframe = self._add_keyframe(kept, motion, np.zeros((6, 6)), None, np.zeros((0, 2)))
        if keyframe.n_points < self._settings.inliers_min:
            self.reset()
            reason = f"{keyframe.n_points} points in both eyes (need {self._settings.inliers_min}); too little texture"
            return self._lost(sight.t_exposure_ns, reason)
        self._last = LastLocatedPair(kept, motion, keyframe.places_left_px, keyframe.points_vo, True)
        status, reason = self._judge_evidence(
            Evidence(keyframe.places_left_px, np.zeros((6, 6)), 1.0, self._texture_grey)
        )
        return OdometryPose(sight.t_exposure_ns, np.eye(4), np.zeros((6, 6)), status, reason, keyframe.n_points)

    def _locate_camera(self, sight: Sight, last: LastLocatedPair) -> LocatedPose | None:
        located = self._fit_pose_to_map(sight, last.motion, last.motion.predict_pose_at(sight.t_exposure_ns), False)
        if located is not None:
            return located
        self._unsure_m = max(self._unsure_m, travel_limit_m(last.motion, sight.t_exposure_ns))
        T_coarse = self._coarse_pose(sight, last)
        return None if T_coarse is None else self._fit_pose_to_map(sight, last.motion, T_coarse, True)

    def _resolve_ambiguous_place(self, sight: Sight, last: LastLocatedPair, located: LocatedPose) -> LocatedPose:
        """After a gap: the best of the places that look alike, in doubt until no other is nearly as good."""
        if last.motion.is_gap(sight.t_exposure_ns):
            self._unsure_m = max(self._unsure_m, travel_limit_m(last.motion, sight.t_exposure_ns))
        if self._unsure_m == 0.0:
            return located
        ways_px = sight.repetition_ways()
        best, others = best_place(
            self._camera, ways_px, located, lambda T_vo_cam: self._fit_pose_to_map(sight, last.motion, T_vo_cam, False)
        )
        if not others:
            self._unsure_m = 0.0
            return replace(best, jumped_to_lookalike=best is not located)
        apart_m = min(float(np.linalg.norm(way)) for way in others)
        spread = sum(np.outer(way, way) for way in others) + self._unsure_m**2 * np.eye(3)
        doubt = (
            f"what is seen repeats itself every {1e3 * apart_m:.0f} mm, and after a gap this may be any of its places; "
            "go to where something does not repeat, or start again"
        )
        return replace(best, lookalike_covariance_m2=np.asarray(spread), doubt_reason=doubt, jumped_to_lookalike=True)

    def _coarse_pose(self, sight: Sight, last: LastLocatedPair) -> Array | None:
        """T_vo_cam by flow from the last pair, the first and the newest keyframe; else by recognising a keyframe."""
        keyframes = (self._keyframes[0], self._keyframes[-1])
        sources = [(last.image_pair, last.left_px, last.points_vo)]
        sources += [(keyframe.image_pair, keyframe.places_left_px, keyframe.points_vo) for keyframe in keyframes]
        T_vo_cam = by_flow(self._camera, sight, sources, self._settings.inliers_min)
        if T_vo_cam is not None:
            return T_vo_cam
        self._recognitions += 1
        return by_recognition(self._camera, sight, self._keyframes, self._recognitions, self._settings.inliers_min)

    def _judge_evidence(self, found: Evidence) -> tuple[OdometryStatus, str]:
        return odometry_verdict(self._settings, self._shape, replace(found, unique_depth=self._unique_depth))

    def _fit_pose_to_map(self, sight: Sight, motion: Motion, T_vo_cam: Array, coarse: bool) -> LocatedPose | None:
        settings = self._settings
        observed = observe_map(
            self._camera,
            self._keyframes,
            sight,
            T_vo_cam,
            settings.points_max,
            settings.sigma_px,
            self._own.on_own_structure,
        )
        frac = COARSE_ALIGNED_MIN_FRAC if coarse else settings.aligned_min_frac
        if len(observed.left_px) < max(frac * observed.n_expected, settings.inliers_min):
            return None
        twist, located = motion.twist(), None
        for _ in range(2 if self._has_rolling_shutter else 1):
            points_vo = self._as_exposed(observed, T_vo_cam, twist.velocity)
            located = self._fit_motions(observed, points_vo, T_vo_cam, twist)
            if located is None:
                return None
            T_vo_cam = inverse_pose(located.fit.T_cam_vo)
            T_vo_cam[:3, :3] = nearest_rotation(T_vo_cam[:3, :3])
            twist = motion.moved_to(T_vo_cam, sight.t_exposure_ns).twist()
        return located

    def _fit_motions(
        self, observed: ObservedPoints, points_vo: Array, T_vo_cam: Array, twist: Twist
    ) -> LocatedPose | None:
        """The world's motion among those in the picture; None where too few of the other points agree with it."""
        settings, T_cam_vo = self._settings, inverse_pose(T_vo_cam)
        problem = pose_problem(T_cam_vo, replace(observed.stereo_points, points_vo=points_vo))
        first = settled_pose(problem, *rough_pose(problem, T_cam_vo))
        if first is None:
            return None
        scene = Scene(
            left_px=observed.left_px,
            rest_squares=problem.squares(np.eye(4), observed.points_row),
            motion_votes=observed.motion_votes,
            points_vo=points_vo,
            noise_factor=problem.noise_factor,
            image_shape=self._shape,
            count_good=settings.count_good(self._shape),
            coverage_good=settings.coverage_good,
        )
        parts, sure = part_motions(problem, first, scene, settings.inliers_min)
        fits = parts if sure else find_motions(problem, first, settings.inliers_min)
        fit, rival, doubt = world_motion(fits, scene)
        if parts and not sure and rival is None:
            rival = world_motion(parts, scene)[0]  # within the noise: not decided, but held by the covariance
        inliers = [other.inliers for other in fits if other is not fit]
        open_to = (problem.whitening_matrices[:, 0, 0] > 0.0) & ~np.any(inliers, axis=0)
        if fit.inliers.sum() < max(settings.inliers_min, INLIERS_MIN_FRAC * np.sum(open_to | fit.inliers)):
            return None
        return LocatedPose(observed, fit, points_vo, twist, scene.rest_squares, rival, doubt)

    @property
    def _has_rolling_shutter(self) -> bool:
        return self._readout.value_s != 0.0 or self._readout.sigma_s > 0.0

    def _image_row_fractions(self, left_px: Array) -> Array:
        return row_fractions(left_px[:, 1], self._camera.height_px)

    def _as_exposed(self, observed: ObservedPoints, T_vo_cam: Array, twist: Array) -> Array:
        """Map points (n, 3) in vo as if they had moved, instead of the camera, until their row was exposed."""
        points_vo = observed.stereo_points.points_vo
        if not self._has_rolling_shutter:
            return points_vo
        points_cam = transform_points(inverse_pose(T_vo_cam), points_vo)
        times_s = self._readout.value_s * self._image_row_fractions(observed.left_px)
        return transform_points(T_vo_cam, moved_by_twist(points_cam, twist, times_s))

    def _settle_keyframe(self, sight: Sight, last: LastLocatedPair, located: LocatedPose) -> LocatedPose:
        """The pair after a keyframe shows how fast that one moved; then the map is adjusted, and the fit repeated."""
        if not self._has_rolling_shutter:
            return located
        keyframe, motion = self._keyframes[-1], last.motion
        twist = motion.twist_between(motion.moved_to(inverse_pose(located.fit.T_cam_vo), sight.t_exposure_ns))
        keyframe.place_points(keyframe.T_vo_cam, twist.velocity, self._readout.value_s)
        self._known.set_twist(len(self._keyframes) - 1, twist.sigma)
        if len(self._keyframes) > 1:
            self._adjust_keyframe_window(located.fit.noise_factor)
        self._last = replace(last, motion=replace(motion, T_vo_cam=keyframe.T_vo_cam))
        again = self._fit_pose_to_map(sight, self._last.motion, inverse_pose(located.fit.T_cam_vo), False)
        return located if again is None else again

    def _accept_located_pose(self, sight: Sight, last: LastLocatedPair, located: LocatedPose) -> OdometryPose:
        fit, observed = located.fit, located.observed_points
        observed.count_misses(fit.inliers)
        if not located.doubt_reason:
            vote_by_pair(self._own, sight, observed, fit, located.rest_squares)
        T_vo_cam = inverse_pose(fit.T_cam_vo)
        T_vo_cam[:3, :3] = nearest_rotation(T_vo_cam[:3, :3])
        inliers_px = observed.left_px[fit.inliers]
        gains = self._pose_sensitivity(located)
        covariance = covariance_in_vo(fit.T_cam_vo, fit.covariance) + self._known.pose_covariance(gains)
        covariance += gains.of_twist @ np.diag(located.twist.sigma**2) @ gains.of_twist.T
        covariance += self._readout.sigma_s**2 * np.outer(gains.of_readout, gains.of_readout)
        self._learn_readout(gains)
        distance_m = float(np.linalg.norm(T_vo_cam[:3, 3]))
        held = (
            covariance
            if located.rival_fit is None
            else _covariance_including_rival(covariance, T_vo_cam, located.rival_fit)
        )
        held = held + np.kron(np.diag([0.0, 1.0]), located.lookalike_covariance_m2)
        evidence = Evidence(
            inliers_px=inliers_px,
            covariance=held,
            rms_sigma=fit.rms_sigma,
            texture_grey=self._texture_grey,
            distance_m=distance_m,
            right_frac=self._right_frac(located),
            doubt_reason=located.doubt_reason,
        )
        status, reason = self._judge_evidence(evidence)
        motion = last.motion.moved_to(T_vo_cam, sight.t_exposure_ns)
        if located.jumped_to_lookalike:  # a step over places that look alike is not a motion
            motion = standing_motion(T_vo_cam, sight.t_exposure_ns)
        frac = self._settings.keyframe_below_frac
        wanted = (
            wants_keyframe(inliers_px, self._shape, frac * self._full_points, frac * self._full_coverage)
            and (motion.is_velocity_known or not self._has_rolling_shutter)
            and not located.doubt_reason
        )
        kept = sight.keep_copy() if wanted else sight
        if wanted:
            seen_here = self._seen_here(located)  # by the list as it is: adding one may forget another
            keyframe = self._add_keyframe(kept, motion, covariance, gains, inliers_px)
            keyframe.seen_here, keyframe.twist_gain = seen_here, gains.of_twist
            self._adjust_keyframe_window(fit.noise_factor)
            T_vo_cam = keyframe.T_vo_cam
            motion = replace(motion, T_vo_cam=T_vo_cam)
        self._last = LastLocatedPair(kept, motion, inliers_px, observed.stereo_points.points_vo[fit.inliers], wanted)
        scale_frac = self._settings.sigma_scale_frac if self._unique_depth else 1.0
        reported = with_scale_error(held, T_vo_cam[:3, 3], scale_frac)
        return OdometryPose(sight.t_exposure_ns, T_vo_cam, reported, status, reason, len(inliers_px))

    def _right_frac(self, located: LocatedPose) -> float:
        """Of the points that the right eye should show, how many it does; 1 where there are too few."""
        on = located.fit.inliers
        expected = expected_right(self._camera, transform_points(located.fit.T_cam_vo, located.points_vo[on]))
        found = np.isfinite(located.observed_points.right_px[on, 0])
        return float(found[expected].mean()) if expected.sum() >= self._settings.inliers_min else 1.0

    def _learn_readout(self, gains: Sensitivity) -> None:
        if self._readout.sigma_s == 0.0:
            return
        self._readout = self._readout.updated_with_step(gains.readout_step_s, gains.readout_information)
        for keyframe in self._keyframes:
            keyframe.place_points(keyframe.T_vo_cam, keyframe.twist, self._readout.value_s)

    def _pose_sensitivity(self, located: LocatedPose) -> Sensitivity:
        observed = located.observed_points
        fractions_key = np.empty(len(observed.keyframe_indices))
        for number in np.unique(observed.keyframe_indices):
            on = observed.keyframe_indices == number
            fractions_key[on] = self._keyframes[number].row_fractions[observed.indices[on]]
        fractions = self._image_row_fractions(observed.left_px)
        shutter = Shutter(fractions, fractions_key, located.twist.velocity, self._readout.size_s)
        return fit_sensitivity(observed, located.fit, located.points_vo, shutter, self._keyframes)

    def _seen_here(self, located: LocatedPose) -> SeenHere:
        observed, on = located.observed_points, located.fit.inliers
        serials = np.array([keyframe.serial for keyframe in self._keyframes], dtype=np.int64)
        return SeenHere(
            serials[observed.keyframe_indices[on]], observed.indices[on], observed.left_px[on], observed.right_px[on]
        )

    def _adjust_keyframe_window(self, noise_factor: float) -> None:
        """Bring the newest keyframes and their points into one best fit."""
        first = max(0, len(self._keyframes) - self._settings.window_keyframes)
        window = self._keyframes[first:]
        joint = adjust_keyframes(self._camera, window, self._readout.value_s, self._settings.sigma_px, noise_factor)
        if joint is not None:
            for row, keyframe in enumerate(window[1:], start=1):
                gain = keyframe.twist_gain * self._known.twist_sigma(first + row)
                joint[6 * row : 6 * row + 6, 6 * row : 6 * row + 6] += gain @ gain.T
            Ts = np.array([keyframe.T_vo_cam for keyframe in window])
            self._known.replace_poses(range(first, len(self._keyframes)), joint, Ts)

    def _add_keyframe(
        self, sight: Sight, motion: Motion, covariance: Array, gains: Sensitivity | None, occupied_px: Array
    ) -> Keyframe:
        camera, settings = self._camera, self._settings
        found = sight.match_eyes(camera, settings.corner_cells, occupied_px)
        free = ~self._own.on_own_structure(found.left_px)
        found = replace(found, left_px=found.left_px[free], right_px=found.right_px[free])
        self._texture_grey, self._unique_depth = found.texture_grey, self._unique_depth and found.disparity_unique
        twist = motion.twist()
        readout_s, self._serial = self._readout.value_s, self._serial + 1
        keyframe = make_keyframe(
            camera, sight, motion.T_vo_cam, twist.velocity, found, settings.sigma_px, readout_s, self._serial
        )
        self._keyframes.append(keyframe)
        self._known.add(covariance, gains, twist.sigma)
        if len(self._keyframes) > settings.keyframes_max:
            del self._keyframes[1]  # the first is the anchor of the whole track
            self._known.remove(1)
        everything = np.concatenate([occupied_px, keyframe.places_left_px])
        self._full_points = min(len(everything), settings.points_max)
        self._full_coverage = covered_cell_count(everything, self._shape)
        return keyframe

    def _lost(self, t_exposure_ns: int, reason: str) -> OdometryPose:
        T_vo_cam = np.eye(4) if self._last is None else self._last.motion.T_vo_cam
        return OdometryPose(t_exposure_ns, T_vo_cam, UNKNOWN_COVARIANCE.copy(), OdometryStatus.LOST, reason, 0)


def _covariance_including_rival(covariance: Array, T_vo_cam: Array, rival: PoseFit) -> Array:
    """A pose's covariance (6, 6) that holds another motion's pose as well."""
    apart = pose_difference(T_vo_cam, inverse_pose(rival.T_cam_vo))
    return covariance + covariance_in_vo(rival.T_cam_vo, rival.covariance) + np.outer(apart, apart)
