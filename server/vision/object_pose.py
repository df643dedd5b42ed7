"""Pose of an object from all its visible markers in both eyes: all planar solutions tried, ambiguity reported."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from machine.description import StereoCamera
from server.vision.ambiguity import (
    PRIOR_AGE_MAX_S,
    PRIOR_CHI2_MAX,
    MotionLimits,
    PosePrior,
    chi2_to_prior,
    covariance_of_both,
    mirrored_pose,
    widened_covariance,
)
from server.vision.contracts import (
    EYES_SWAPPED_REASON,
    MOVED_MARKER_REASON,
    ROWS_DIFFER_REASON,
    Array,
    MarkerView,
    ObjectPose,
    PoseStatus,
)
from server.vision.pose_problem import PointSighting, PoseProblem, SeenGroup, Sighting, pose_problem
from server.vision.pose_refinement import RefinedPose, distinct_minima

ObjectName = Literal["tool", "ooi"]
SAME_POSE_ANGLE_MAX_RAD = float(np.deg2rad(0.5))
NO_RIVAL_CHI2_MARGIN = float("inf")


# One eye's view of one target that lies: something bright covers an edge, and the corners follow its border.
#
# A white board in front of a marker's lower edge looks like the marker's own quiet zone, so the detector cannot know.
# The other eye looks past it, and the rigid layout outvotes the one view. A target that has really moved lies in both.

TARGETS_MIN = 2  # with one target only nothing can outvote its other eye
RESIDUAL_LEFT_MAX_FRAC = 0.4  # of the residual at most, once the lying view is out
# Leaving out any other view leaves at least so many times as much: it is that view and no other
RUNNER_UP_RATIO_MIN = 1.5
EYE_NAMES = ("left", "right")


@dataclass(frozen=True, slots=True)
class ConsistentSightings:
    """The sightings without the view that contradicts all others, and what to say of it."""

    sightings: tuple[Sighting | PointSighting, ...]
    reason: str


def without_covered_view(problem: PoseProblem, best: RefinedPose, apart_rad: float) -> ConsistentSightings | None:
    """The view whose absence, and no other's, makes the rest fit; None where there is no such view.

    Args: best: the pose by all views; apart_rad: minima nearer than this are one.
    """
    groups = _doubly_seen(problem)
    if len({group.sighting_index for group in problem.groups}) < TARGETS_MIN or len(problem.groups) < 4 or not groups:
        return None
    left = np.array([_rms_without(problem, group, best.T_cam_object, apart_rad) for group in groups])
    order = np.argsort(left)
    chosen, least = groups[int(order[0])], float(left[order[0]])
    before = float(np.sqrt(best.sum_squares_px2 / best.residuals_px.size))
    if least > RESIDUAL_LEFT_MAX_FRAC * before or (len(order) > 1 and left[order[1]] < RUNNER_UP_RATIO_MIN * least):
        return None
    sightings = list(problem.sightings)
    one, eye = sightings[chosen.sighting_index], EYE_NAMES[chosen.eye_index]
    sightings[chosen.sighting_index] = (
        replace(one, left_px=None) if chosen.eye_index == 0 else replace(one, right_px=None)
    )
    return ConsistentSightings(
        tuple(sightings), f"marker {one.target_id} is covered in the {eye} eye by something bright: not used there"
    )


def _doubly_seen(problem: PoseProblem) -> list[SeenGroup]:
    """Views of targets that the other eye sees, too."""
    seen = [group.sighting_index for group in problem.groups]
    return [group for group in problem.groups if seen.count(group.sighting_index) > 1]


def _rms_without(problem: PoseProblem, group: SeenGroup, T_cam_object: Array, apart_rad: float) -> float:
    rows = np.ones(len(problem.observations.points_object), dtype=bool)
    rows[group.first_row : group.end_row] = False
    found = distinct_minima(T_cam_object[None], problem.observations.subset(rows), apart_rad)
    if not found:
        return float("inf")
    return float(np.sqrt(found[0].sum_squares_px2 / found[0].residuals_px.size))


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """What corners are worth and when a pose is believed."""

    sigma_px: float = 0.06  # standard deviation of one corner coordinate
    residual_max_px: float = 2.0  # rms above which the layout and the images contradict each other
    covered_rms_px: float = 0.3  # rms above which one eye's view of one target is asked whether it is covered
    chi2_margin_min: float = (
        11.0  # between the two planar solutions: the wrong one wins by that much once in 1700 at worst
    )
    tilt_sigma_max_deg: float = 12.0  # an orientation known worse than this is not one
    epipolar_max_px: float = 3.0  # row difference of the eyes above which the rig is not what the file says
    motion_limits: MotionLimits = field(default_factory=MotionLimits)  # how far a pose may be from the one before


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A minimum, its covariance, and by how much chi2 it fits better than the best of the others."""

    refined_pose: RefinedPose
    covariance: Array
    margin_chi2: float


def estimate_object_pose(
    on: ObjectName,
    sightings: Sequence[Sighting | PointSighting],
    camera: StereoCamera,
    settings: PoseSettings,
    contradiction: str | None = None,
    prior: PosePrior | None = None,
) -> tuple[ObjectPose, tuple[MarkerView, ...]]:
    """Pose of one object and what became of each of its markers.

    Model:   minimum over T_cam_object of the sum over targets, points and eyes of |pi(T_cam_object X) - u|^2 in raw px,
             started from both planar solutions of each target in each eye. The covariance is sigma^2 (J^T J)^-1, sigma
             at least `settings.sigma_px` and larger where the residuals say so, widened where the valley is flat.
             The margin is the rival minimum's chi2 minus the best one's; so both eyes and the rigid layout choose.
             Where they cannot, the prior may (chi2 to it added on both sides), and the reason says so; else the pose is
             ambiguous: position usable, and its covariance holds both orientations.
    Args:    sightings: markers and boards seen by at least one eye, in raw px. contradiction: why the rig is not to be
             believed, "" if that was asked already; None asks these sightings. prior: the object's pose a moment ago.
    Returns: ObjectPose (left camera), and one MarkerView per sighting.
    """
    if not sightings:
        return not_seen(on, f"no marker of the {on} in either eye; move or light it so that one is in view"), ()
    problem = pose_problem(sightings, camera)
    contradiction = _contradiction_of(problem, settings) if contradiction is None else contradiction
    if contradiction:
        return _rejected_pose(on, problem, contradiction, float("nan"))
    minima = _pose_minima(problem, range(len(sightings)))
    if not minima:
        return _rejected_pose(on, problem, "no pose puts the corners in front of the camera", float("nan"))
    if _residual_rms_px(minima[0]) > settings.covered_rms_px:
        cleared = without_covered_view(problem, minima[0], SAME_POSE_ANGLE_MAX_RAD)
        if cleared is not None:
            found, views = estimate_object_pose(on, cleared.sightings, camera, settings, "", prior)
            return replace(found, reason="; ".join(text for text in (found.reason, cleared.reason) if text)), views
    used = list(range(len(sightings)))
    dropped: dict[int, str] = {}
    if _residual_rms_px(minima[0]) > settings.residual_max_px and len(used) > 1:
        minima, dropped = _without_the_worst(problem, minima, settings)
        used = [index for index in used if index not in dropped]
    if _residual_rms_px(minima[0]) > settings.residual_max_px:
        reason = (
            f"{on}: residual {_residual_rms_px(minima[0]):.2f} px rms exceeds {settings.residual_max_px:g} px; "
            "check marker sides, layout and camera file"
        )
        return _rejected_pose(on, problem, reason, _residual_rms_px(minima[0]))
    found, fit = _accepted_pose(on, problem, used, minima, settings, prior)
    return found, _marker_views(problem, fit, used, dropped)


def not_seen(on: ObjectName, reason: str) -> ObjectPose:
    """The status of an object that no eye shows."""
    return ObjectPose(on, PoseStatus.NOT_SEEN, reason, None, None, (), float("nan"), NO_RIVAL_CHI2_MARGIN)


def fitted_variance(sum_squares_px2: float, dof: int, sigma_px: float) -> float:
    """Variance of one coordinate [px^2]: the assumed one, unless the residuals refute it at the 1 % level."""
    if dof <= 0:
        return sigma_px**2
    fitted = sum_squares_px2 / dof
    limit = (1.0 - 2.0 / (9.0 * dof) + 2.326 * np.sqrt(2.0 / (9.0 * dof))) ** 3  # Wilson and Hilferty 1931, 99 %
    return float(fitted) if fitted > limit * sigma_px**2 else sigma_px**2


def rig_contradiction(
    sightings: Sequence[Sighting | PointSighting], camera: StereoCamera, settings: PoseSettings
) -> str:
    """Why the two eyes cannot belong together as the camera file says; empty when they can."""
    return _contradiction_of(pose_problem(sightings, camera), settings)


def _contradiction_of(problem: PoseProblem, settings: PoseSettings) -> str:
    left, right = problem.common_pixels()
    if not len(left):
        return ""
    disparity = float(np.median(left[:, 0] - right[:, 0]))
    if disparity < 0.0:
        return f"disparity {disparity:.1f} px is negative; {EYES_SWAPPED_REASON}"
    row = float(np.median(left[:, 1] - right[:, 1]))
    if abs(row) > settings.epipolar_max_px:
        return f"{ROWS_DIFFER_REASON} by {row:.1f} px (limit {settings.epipolar_max_px:g} px); recalibrate the rig"
    return ""


def _pose_minima(problem: PoseProblem, indices: Sequence[int]) -> list[RefinedPose]:
    """Distinct local minima, the best first."""
    observations = problem.observations_of(indices)
    found = distinct_minima(problem.starting_poses(indices), observations, SAME_POSE_ANGLE_MAX_RAD)
    if not found:
        return []
    other = mirrored_pose(found[0].T_cam_object, observations.points_object, observations.eye_x_m)
    starts = np.array([*(minimum.T_cam_object for minimum in found), other])
    return distinct_minima(starts, observations, SAME_POSE_ANGLE_MAX_RAD)


def _residual_rms_px(refined: RefinedPose) -> float:
    """Root mean square of the corners' distance over sqrt 2, that is per coordinate [px]."""
    return float(np.sqrt(refined.sum_squares_px2 / refined.residuals_px.size))


def _without_the_worst(
    problem: PoseProblem, minima: list[RefinedPose], settings: PoseSettings
) -> tuple[list[RefinedPose], dict[int, str]]:
    """The best pose that leaves one marker out, where that explains the residual; two must remain to outvote it."""
    indices = range(len(problem.sightings))
    if len(indices) < 3:
        return minima, {}
    trials = [(_pose_minima(problem, [i for i in indices if i != left_out]), left_out) for left_out in indices]
    trials = [(trial, left_out) for trial, left_out in trials if trial]
    best, left_out = min(trials, key=lambda trial: trial[0][0].sum_squares_px2, default=(minima, -1))
    if left_out < 0 or _residual_rms_px(best[0]) > settings.residual_max_px:
        return minima, {}
    marker_id = problem.sightings[left_out].target_id
    reason = f"marker {marker_id} contradicts the others; it has {MOVED_MARKER_REASON} or its layout entry is wrong"
    return best, {left_out: reason}


def _pose_candidate(
    minima: list[RefinedPose], rank: int, problem: PoseProblem, used: Sequence[int], settings: PoseSettings
) -> _Candidate | None:
    """A minimum with its covariance; None where the corners do not determine a pose."""
    fit, best = minima[rank], minima[0]
    variance = fitted_variance(best.sum_squares_px2, best.residuals_px.size - 6, settings.sigma_px)
    try:
        covariance = variance * np.linalg.inv(fit.information)
    except np.linalg.LinAlgError:
        return None
    covariance = 0.5 * (covariance + covariance.T)
    if not np.isfinite(covariance).all() or np.linalg.eigvalsh(covariance)[0] <= 0.0:
        return None
    observations, alone = problem.observations_of(used), len(minima) == 1
    wide = widened_covariance(fit.T_cam_object, covariance, variance, fit.sum_squares_px2, observations, alone)
    others = [minimum.sum_squares_px2 for k, minimum in enumerate(minima) if k != rank]
    margin = (min(others) - fit.sum_squares_px2) / variance if others else NO_RIVAL_CHI2_MARGIN
    return _Candidate(fit, wide, float(margin))


def _chosen_by_time(
    both: tuple[_Candidate, _Candidate], settings: PoseSettings, prior: PosePrior | None
) -> _Candidate | None:
    """The one of two orientations that follows from the last moments, if these rule the other one out."""
    if prior is None or not 0.0 <= prior.age_s <= PRIOR_AGE_MAX_S:
        return None
    distances = [
        chi2_to_prior(candidate.refined_pose.T_cam_object, candidate.covariance, prior, settings.motion_limits)
        for candidate in both
    ]
    nearer = int(np.argmin(distances))
    winner = both[nearer]
    margin = winner.margin_chi2 + distances[1 - nearer] - distances[nearer]  # images and time together
    if distances[nearer] > PRIOR_CHI2_MAX or margin < settings.chi2_margin_min:
        return None
    return _Candidate(winner.refined_pose, winner.covariance, float(margin))


def _accepted_pose(
    on: ObjectName,
    problem: PoseProblem,
    used: Sequence[int],
    minima: list[RefinedPose],
    settings: PoseSettings,
    prior: PosePrior | None,
) -> tuple[ObjectPose, RefinedPose]:
    best = _pose_candidate(minima, 0, problem, used, settings)
    if best is None:
        return _rejected_pose(on, problem, f"{on}: the corners do not determine a pose", _residual_rms_px(minima[0]))[
            0
        ], minima[0]
    status, reason, covariance = PoseStatus.OK, "", best.covariance
    if best.margin_chi2 < settings.chi2_margin_min:
        rival = _pose_candidate(minima, 1, problem, used, settings)
        by_time = None if rival is None else _chosen_by_time((best, rival), settings, prior)
        if by_time is not None and prior is not None:
            best, covariance = by_time, by_time.covariance
            reason = f"{on}: two orientations fit; chosen by its pose {prior.age_s:.2f} s ago"
        else:
            status = PoseStatus.ORIENTATION_AMBIGUOUS
            covariance = covariance_of_both(
                best.refined_pose.T_cam_object, minima[1].T_cam_object, best.margin_chi2, covariance
            )
            reason = (
                f"{on}: two orientations fit (chi2 margin {best.margin_chi2:.1f}, limit {settings.chi2_margin_min:g}); "
                "come closer, view it more obliquely, or show another marker"
            )
    tilt_sigma_deg = float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(best.covariance[:3, :3])[-1])))
    if status is PoseStatus.OK and tilt_sigma_deg > settings.tilt_sigma_max_deg:
        status = PoseStatus.ORIENTATION_AMBIGUOUS
        limit = settings.tilt_sigma_max_deg
        reason = f"{on}: orientation known to {tilt_sigma_deg:.1f} deg only (limit {limit:g}); come closer"
    ids = tuple(problem.sightings[index].target_id for index in used)
    T, rms = best.refined_pose.T_cam_object, _residual_rms_px(best.refined_pose)
    return ObjectPose(on, status, reason, T, covariance, ids, rms, best.margin_chi2), best.refined_pose


def _rejected_pose(
    on: ObjectName, problem: PoseProblem, reason: str, rms_px: float
) -> tuple[ObjectPose, tuple[MarkerView, ...]]:
    ids = tuple(sighting.target_id for sighting in problem.sightings)
    views = tuple(
        MarkerView(sighting.target_id, sighting.left_px, sighting.right_px, rms_px, False, reason)
        for sighting in problem.sightings
    )
    return ObjectPose(on, PoseStatus.REJECTED, reason, None, None, ids, rms_px, NO_RIVAL_CHI2_MARGIN), views


def _marker_views(
    problem: PoseProblem, best: RefinedPose, used: Sequence[int], dropped: dict[int, str]
) -> tuple[MarkerView, ...]:
    rows = problem.rows_of(used)
    squares = np.full(len(rows), np.nan)
    squares[rows] = np.mean(best.residuals_px**2, axis=1)
    views = []
    for index, sighting in enumerate(problem.sightings):
        own = squares[problem.rows_of([index])]
        rms = float(np.sqrt(np.mean(own))) if len(own) else float("nan")
        reason = dropped.get(index, "" if len(own) else "no eye sees a point of it")
        seen = sighting.target_id, sighting.left_px, sighting.right_px
        views.append(MarkerView(*seen, rms, reason == "", reason))
    return tuple(views)
