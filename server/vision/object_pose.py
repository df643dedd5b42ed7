"""Pose of an object from all its visible markers in both eyes: all planar solutions tried, ambiguity told."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machine.camera import undistort_to_rays
from machine.description import Marker, StereoCamera
from machine.markers import marker_corners
from machine.poses import inverse_pose, transform_points
from machine.rotations import geodesic_angle, rotvec_from_rotation
from server.vision.ambiguity import mirrored_pose, profile_sum_squares
from server.vision.contracts import Array, MarkerView, ObjectPose, PoseStatus
from server.vision.planar_pose import planar_poses
from server.vision.pose_refinement import PointObservations, RefinedPose, refine_pose

ObjectName = Literal["tool", "ooi"]
SAME_MINIMUM_RAD = np.deg2rad(0.5)
NO_RIVAL = float("inf")
RULED_OUT_CHI2 = 9.0  # 3 sigma


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """What corners are worth and when a pose is believed."""

    sigma_px: float = 0.06  # standard deviation of one corner coordinate
    residual_max_px: float = 2.0  # rms above which the layout and the images contradict each other
    chi2_margin_min: float = 9.0  # 3 sigma between the two planar solutions
    tilt_sigma_max_deg: float = 5.0  # an orientation known worse than this is not one
    epipolar_max_px: float = 3.0  # row difference of the eyes above which the rig is not what the file says


@dataclass(frozen=True, slots=True)
class Sighting:
    """One marker of an object in one pair; corners (4, 2) [raw px] or None where an eye does not see it."""

    marker: Marker
    left_px: Array | None
    right_px: Array | None


@dataclass(frozen=True, slots=True)
class _Problem:
    """All sightings of one object, undistorted once."""

    sightings: tuple[Sighting, ...]
    rays: tuple[tuple[Array | None, Array | None], ...]
    camera: StereoCamera


def estimate_object_pose(
    on: ObjectName, sightings: Sequence[Sighting], camera: StereoCamera, settings: PoseSettings, contradiction: str = ""
) -> tuple[ObjectPose, tuple[MarkerView, ...]]:
    """Pose of one object and what became of each of its markers.

    Model:   minimum over T_cam_object of the sum over markers, corners and eyes of
             |pi(T_cam_object T_object_marker X) - u|^2, started from both planar solutions of each marker in each eye;
             the margin is the rival minimum's chi2 minus the best one's. The covariance is sigma^2 (J^T J)^-1, sigma at
             least `settings.sigma_px` and larger where the residuals say so.
    Args:    sightings: markers seen by at least one eye, corners in raw px. contradiction: why the rig is not to be
             believed, if known already; otherwise these sightings are asked.
    Returns: ObjectPose (left camera), and one MarkerView per sighting.
    """
    if not sightings:
        return not_seen(on, f"no marker of the {on} in either eye; move or light it so that one is in view"), ()
    problem = _Problem(tuple(sightings), tuple(_rays(sighting, camera) for sighting in sightings), camera)
    contradiction = contradiction or rig_contradiction(sightings, camera, settings)
    if contradiction:
        return _rejected(on, problem, contradiction, float("nan"))
    minima = _minima(problem, range(len(sightings)))
    if not minima:
        return _rejected(on, problem, "no pose puts the corners in front of the camera", float("nan"))
    used = list(range(len(sightings)))
    dropped: dict[int, str] = {}
    if _rms(minima[0]) > settings.residual_max_px and len(used) > 1:
        minima, dropped = _without_the_worst(problem, minima, settings)
        used = [index for index in used if index not in dropped]
    if _rms(minima[0]) > settings.residual_max_px:
        reason = (
            f"{on}: residual {_rms(minima[0]):.2f} px rms exceeds {settings.residual_max_px:g} px; check marker sides, "
            "layout and camera file"
        )
        return _rejected(on, problem, reason, _rms(minima[0]))
    return _accepted(on, problem, used, minima, settings), _views(problem, minima[0], used, dropped)


def not_seen(on: ObjectName, reason: str) -> ObjectPose:
    """The status of an object that no eye shows."""
    return ObjectPose(on, PoseStatus.NOT_SEEN, reason, None, None, (), float("nan"), NO_RIVAL)


def fitted_variance(sum_squares_px2: float, dof: int, sigma_px: float) -> float:
    """Variance of one coordinate [px^2]: the assumed one, unless the residuals refute it at the 1 % level."""
    if dof <= 0:
        return sigma_px**2
    fitted = sum_squares_px2 / dof
    limit = (1.0 - 2.0 / (9.0 * dof) + 2.326 * np.sqrt(2.0 / (9.0 * dof))) ** 3  # Wilson and Hilferty 1931, 99 %
    return float(fitted) if fitted > limit * sigma_px**2 else sigma_px**2


def rig_contradiction(sightings: Iterable[Sighting], camera: StereoCamera, settings: PoseSettings) -> str:
    """Why the two eyes cannot belong together as the camera file says; empty when they can."""
    rows, disparities = [], []
    for left, right in (_rays(sighting, camera) for sighting in sightings):
        if left is not None and right is not None:
            rows.append((left[:, 1] - right[:, 1]) * camera.fy_px)
            disparities.append((left[:, 0] - right[:, 0]) * camera.fx_px)
    if not rows:
        return ""
    disparity = float(np.median(np.concatenate(disparities)))
    if disparity < 0.0:
        return f"disparity {disparity:.1f} px is negative; left and right eye are swapped"
    row = float(np.median(np.concatenate(rows)))
    if abs(row) > settings.epipolar_max_px:
        return (
            f"rows of the two eyes differ by {row:.1f} px (limit {settings.epipolar_max_px:g} px); recalibrate the rig"
        )
    return ""


def _rays(sighting: Sighting, camera: StereoCamera) -> tuple[Array | None, Array | None]:
    left = None if sighting.left_px is None else undistort_to_rays(camera, sighting.left_px)
    right = None if sighting.right_px is None else undistort_to_rays(camera, sighting.right_px)
    return left, right


def _observations(problem: _Problem, indices: Sequence[int]) -> PointObservations:
    focal = np.array([problem.camera.fx_px, problem.camera.fy_px])
    points, seen, eye_x = [], [], []
    for index in indices:
        marker = problem.sightings[index].marker
        corners = transform_points(marker.T_on_marker, marker_corners(marker.side_m))
        for rays, x_m in zip(problem.rays[index], (0.0, problem.camera.baseline_m), strict=True):
            if rays is not None:
                points.append(corners)
                seen.append(rays * focal)
                eye_x.append(np.full(len(corners), x_m))
    return PointObservations(np.concatenate(points), np.concatenate(seen), np.concatenate(eye_x), focal)


def _starts(problem: _Problem, indices: Sequence[int]) -> list[Array]:
    """T_cam_object by both planar solutions of every marker in every eye."""
    starts = []
    for index in indices:
        marker = problem.sightings[index].marker
        T_marker_object = inverse_pose(marker.T_on_marker)
        for rays, x_m in zip(problem.rays[index], (0.0, problem.camera.baseline_m), strict=True):
            for T_eye_marker in () if rays is None else planar_poses(rays, marker.side_m):
                start = T_eye_marker @ T_marker_object
                start[0, 3] += x_m
                starts.append(start)
    return starts


def _minima(problem: _Problem, indices: Sequence[int]) -> list[RefinedPose]:
    """Distinct local minima, the best first."""
    observations = _observations(problem, indices)
    refined = [refine_pose(start, observations) for start in _starts(problem, indices)]
    refined += [refine_pose(_mirrored(one.T_cam_object, observations), observations) for one in _finite(refined)[:1]]
    distinct: list[RefinedPose] = []
    for one in _finite(refined):
        rotation = one.T_cam_object[:3, :3]
        if all(geodesic_angle(rotation, other.T_cam_object[:3, :3]) > SAME_MINIMUM_RAD for other in distinct):
            distinct.append(one)
    return distinct


def _finite(refined: list[RefinedPose]) -> list[RefinedPose]:
    """Poses in front of the camera, the best first."""
    return sorted((one for one in refined if np.isfinite(one.sum_squares_px2)), key=lambda one: one.sum_squares_px2)


def _mirrored(T_cam_object: Array, observations: PointObservations, share: float = 1.0) -> Array:
    return mirrored_pose(T_cam_object, observations.points_object, observations.eye_x_m, share)


def _chi2_margin(
    minima: list[RefinedPose], covariance: Array, variance: float, observations: PointObservations
) -> float:
    """Chi2 by which the rival orientation fits worse; inf when there is none.

    A rival is another minimum, or the frontal or mirrored orientation where the covariance rules it out: near the
    frontal view the two minima merge into one flat valley, along which a covariance taken at its bottom is too sure.
    """
    best = minima[0]
    rivals = [one.sum_squares_px2 for one in minima[1:2]]
    for share in (0.5, 1.0):
        other = _mirrored(best.T_cam_object, observations, share)
        apart = rotvec_from_rotation(other[:3, :3] @ best.T_cam_object[:3, :3].T)
        if apart @ np.linalg.solve(covariance[:3, :3], apart) > RULED_OUT_CHI2:
            rivals.append(profile_sum_squares(other, observations))
    return (min(rivals) - best.sum_squares_px2) / variance if rivals else NO_RIVAL


def _rms(refined: RefinedPose) -> float:
    """Root mean square of the corners' distance over sqrt 2, that is per coordinate [px]."""
    return float(np.sqrt(refined.sum_squares_px2 / refined.residuals_px.size))


def _without_the_worst(
    problem: _Problem, minima: list[RefinedPose], settings: PoseSettings
) -> tuple[list[RefinedPose], dict[int, str]]:
    """The best pose that leaves one marker out, where that explains the residual; two must remain to outvote it."""
    indices = range(len(problem.sightings))
    if len(indices) < 3:
        return minima, {}
    trials = [(_minima(problem, [i for i in indices if i != left_out]), left_out) for left_out in indices]
    trials = [(trial, left_out) for trial, left_out in trials if trial]
    best, left_out = min(trials, key=lambda trial: trial[0][0].sum_squares_px2, default=(minima, -1))
    if left_out < 0 or _rms(best[0]) > settings.residual_max_px:
        return minima, {}
    marker_id = problem.sightings[left_out].marker.marker_id
    reason = f"marker {marker_id} contradicts the others; it has moved on its board or its layout entry is wrong"
    return best, {left_out: reason}


def _covariance(refined: RefinedPose, settings: PoseSettings) -> Array | None:
    variance = fitted_variance(refined.sum_squares_px2, refined.residuals_px.size - 6, settings.sigma_px)
    try:
        covariance = variance * np.linalg.inv(refined.information)
    except np.linalg.LinAlgError:
        return None
    return 0.5 * (covariance + covariance.T) if np.isfinite(covariance).all() else None


def _accepted(
    on: ObjectName, problem: _Problem, used: Sequence[int], minima: list[RefinedPose], settings: PoseSettings
) -> ObjectPose:
    best = minima[0]
    covariance = _covariance(best, settings)
    if covariance is None:
        return _rejected(on, problem, f"{on}: the corners do not determine a pose", _rms(best))[0]
    variance = fitted_variance(best.sum_squares_px2, best.residuals_px.size - 6, settings.sigma_px)
    margin = _chi2_margin(minima, covariance, variance, _observations(problem, used))
    status, reason = PoseStatus.OK, ""
    tilt_sigma_deg = float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])))
    if margin < settings.chi2_margin_min:
        status = PoseStatus.ORIENTATION_AMBIGUOUS
        reason = (
            f"{on}: two orientations fit (chi2 margin {margin:.1f}, limit {settings.chi2_margin_min:g}); "
            "come closer, view it more obliquely, or show another marker"
        )
    elif tilt_sigma_deg > settings.tilt_sigma_max_deg:
        status = PoseStatus.ORIENTATION_AMBIGUOUS
        limit = settings.tilt_sigma_max_deg
        reason = f"{on}: orientation known to {tilt_sigma_deg:.1f} deg only (limit {limit:g}); come closer"
    ids = tuple(problem.sightings[index].marker.marker_id for index in used)
    return ObjectPose(on, status, reason, best.T_cam_object, covariance, ids, _rms(best), float(margin))


def _rejected(
    on: ObjectName, problem: _Problem, reason: str, rms_px: float
) -> tuple[ObjectPose, tuple[MarkerView, ...]]:
    ids = tuple(sighting.marker.marker_id for sighting in problem.sightings)
    views = tuple(
        MarkerView(one.marker.marker_id, one.left_px, one.right_px, rms_px, False, reason) for one in problem.sightings
    )
    return ObjectPose(on, PoseStatus.REJECTED, reason, None, None, ids, rms_px, NO_RIVAL), views


def _views(
    problem: _Problem, best: RefinedPose, used: Sequence[int], dropped: dict[int, str]
) -> tuple[MarkerView, ...]:
    views: dict[int, MarkerView] = {}
    row = 0
    for index in used:
        sighting = problem.sightings[index]
        count = 4 * ((sighting.left_px is not None) + (sighting.right_px is not None))
        rms = float(np.sqrt(np.mean(best.residuals_px[row : row + count] ** 2)))
        row += count
        views[index] = MarkerView(sighting.marker.marker_id, sighting.left_px, sighting.right_px, rms, True, "")
    for index, reason in dropped.items():
        one = problem.sightings[index]
        views[index] = MarkerView(one.marker.marker_id, one.left_px, one.right_px, float("nan"), False, reason)
    return tuple(views[index] for index in sorted(views))
