"""The other orientation of a planar target: where it is, how much worse it fits, and what the last pairs say.

`object_pose.py` sets the status ORIENTATION_AMBIGUOUS by it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from machine.poses import pose_difference
from server.vision.contracts import Array, ObjectPose, PoseStatus
from server.vision.pose_refinement import KernelArrays, PointObservations, kernel_arrays, sum_squares
from server.vision.small_algebra import apply, rotated_by_rotvec, solve_positive

PROFILE_ITERATIONS = 6
PROFILE_REACH_SIGMAS = 2.45
REACH_ITERATIONS = 6
REACH_MIN, REACH_MAX = 0.25, 6.0
CHI2_RISE_MAX = 16.0  # an orientation that fits worse by more needs no room


def mirrored_pose(T_cam_object: Array, points_object: Array, eye_x_m: Array, share: float = 1.0) -> Array:
    """The pose whose normal is mirrored at the line of sight, the points' middle kept in place.

    Model:   n' = 2 (n.s) s - n, s from the middle of the seeing eyes to the points' middle: to first order in the
             target's size over its distance both orientations give the same image.
    Args:    share: of the way to the mirrored pose; 0.5 is the frontal one.
    Source:  Schweighofer and Pinz 2006, section 4.
    """
    return _partly_mirrored_pose(
        np.ascontiguousarray(T_cam_object, dtype=np.float64),
        np.ascontiguousarray(points_object.mean(axis=0)),
        float(np.mean(eye_x_m)),
        share,
    )


@njit(cache=True, nogil=True)
def _partly_mirrored_pose(T_cam_object: Array, middle_object: Array, eye_x_m: float, share: float) -> Array:
    rotation = T_cam_object[:3, :3].copy()
    middle = apply(rotation, middle_object) + T_cam_object[:3, 3]
    sight = -middle
    sight[0] += eye_x_m
    sight /= math.sqrt(sight[0] ** 2 + sight[1] ** 2 + sight[2] ** 2)
    nx, ny, nz = rotation[0, 2], rotation[1, 2], rotation[2, 2]
    axis = np.array([ny * sight[2] - nz * sight[1], nz * sight[0] - nx * sight[2], nx * sight[1] - ny * sight[0]])
    sine = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    T = T_cam_object.copy()
    if sine < 1e-12:
        return T
    angle = 2.0 * share * math.atan2(sine, nx * sight[0] + ny * sight[1] + nz * sight[2])
    mirrored = rotated_by_rotvec(rotation, axis * (angle / sine))
    T[:3, :3], T[:3, 3] = mirrored, middle - apply(mirrored, middle_object)
    return T


def covariance_of_both(T_best: Array, T_rival: Array, margin_chi2: float, covariance: Array) -> Array:
    """Second moment (6, 6) about the best pose when the rival may be the true one.

    Model:   C + w d d^T, d the rival's deviation from the best, w = 1 / (1 + exp(margin / 2)) its probability.
    """
    apart = pose_difference(T_best, T_rival)
    return covariance + np.outer(apart, apart) / (1.0 + np.exp(0.5 * margin_chi2))


@njit(cache=True, nogil=True)
def _best_cost_for_rotation(rotation: Array, position: Array, given: KernelArrays) -> float:
    """Smallest sum of squares [px^2] over all positions for one rotation, Gauss-Newton; inf behind the glass."""
    points, seen, eye_x, focal, weights = given
    place = position.copy()
    total = sum_squares(rotation, place, given)
    A, g = np.empty((3, 3)), np.empty(3)
    row, col = np.empty(3), np.empty(3)
    for _ in range(PROFILE_ITERATIONS):
        if not total < np.inf:
            break
        A[:], g[:] = 0.0, 0.0
        for i in range(points.shape[0]):
            x, y, z = place
            for k in range(3):
                x += rotation[0, k] * points[i, k]
                y += rotation[1, k] * points[i, k]
                z += rotation[2, k] * points[i, k]
            u, v = (x - eye_x[i]) / z, y / z
            du, dv = focal[0] * u - seen[i, 0], focal[1] * v - seen[i, 1]
            p, q = focal[0] / z, focal[1] / z
            w = weights[i]
            row[0], row[1], row[2] = w[0, 0] * p, w[0, 1] * q, -w[0, 0] * p * u - w[0, 1] * q * v
            col[0], col[1], col[2] = w[1, 0] * p, w[1, 1] * q, -w[1, 0] * p * u - w[1, 1] * q * v
            a, b = w[0, 0] * du + w[0, 1] * dv, w[1, 0] * du + w[1, 1] * dv
            for j in range(3):
                g[j] += row[j] * a + col[j] * b
                for k in range(3):
                    A[j, k] += row[j] * row[k] + col[j] * col[k]
        new_place = place + solve_positive(A, -g)
        new_total = sum_squares(rotation, new_place, given)
        if not new_total < total:
            break
        done = total - new_total < 1e-6 * total
        place, total = new_place, new_total
        if done:
            break
    return total


def profile_sum_squares(T_cam_object: Array, observations: PointObservations) -> float:
    """Smallest sum of squared residuals [px^2] that any position reaches with this rotation; inf behind the camera.

    Model:   min over t of sum |pi(R X + t) - u|^2, Gauss-Newton in t.
    """
    rotation, position = np.ascontiguousarray(T_cam_object[:3, :3]), np.ascontiguousarray(T_cam_object[:3, 3])
    return float(_best_cost_for_rotation(rotation, position, kernel_arrays(observations)))


@njit(cache=True, nogil=True)
def _steps_to_cost_rise(
    rotation: Array, position: Array, step: Array, rise: float, best: float, given: KernelArrays
) -> float:
    """How many times `step` (6,) must be taken until the profile has risen by `rise` [px^2]; 0.25 to 6."""
    low, high, at, found = 0.0, np.inf, 1.0, 1.0
    for _ in range(REACH_ITERATIONS):
        total = _best_cost_for_rotation(rotated_by_rotvec(rotation, at * step[:3]), position + at * step[3:], given)
        found = at
        ratio = (total - best) / rise
        if abs(ratio - 1.0) < 0.1:
            break
        if ratio < 1.0:
            low = at
            if at >= REACH_MAX:
                break
        else:
            high = at
        guess = at / math.sqrt(max(ratio, 0.04)) if ratio < np.inf else 0.5 * at
        if not low < guess < high:
            guess = 0.5 * (low + high)
        at = min(max(guess, REACH_MIN), REACH_MAX)
    return found


@njit(cache=True, nogil=True)
def _widened_covariance(T: Array, covariance: Array, variance: float, best: float, given: KernelArrays) -> Array:
    rotation, position = T[:3, :3].copy(), T[:3, 3].copy()
    axes = np.linalg.eigh(covariance[:3, :3])[1]
    wide = covariance.copy()
    for k in range(1, 3):  # the two least known axes: a flat target's tilts
        along = np.zeros(6)
        for i in range(6):
            for j in range(3):
                along[i] += covariance[i, j] * axes[j, k]
        own = 0.0
        for j in range(3):
            own += along[j] * axes[j, k]
        step = (
            PROFILE_REACH_SIGMAS * along / math.sqrt(own)
        )  # the best fit's way when this angle is moved by so many sigma
        rise = PROFILE_REACH_SIGMAS**2 * variance
        there = _steps_to_cost_rise(rotation, position, step, rise, best, given)
        back = _steps_to_cost_rise(rotation, position, -step, rise, best, given)
        grown = max(there, back, 1.0) ** 2 - 1.0
        for i in range(6):
            for j in range(6):
                wide[i, j] += grown * along[i] * along[j] / own
    return wide


def widened_covariance(
    T_cam_object: Array,
    covariance: Array,
    variance: float,
    best_px2: float,
    observations: PointObservations,
    alone: bool = True,
) -> Array:
    """Covariance as wide as the likelihood really is along the two tilts.

    Model:   near the frontal view the sum of squares is a flat valley whose bottom is bent: the normal equations at its
             lowest point are too sure. Along each of the two least known rotation axes the way is found, both ways, to
             where the profile over positions has risen by 2.45^2 variances; the axis' sigma follows from the longer
             one. Then, for a minimum that stands alone, the frontal and the mirrored orientation: where the profile
             there has risen by less than the covariance says, C grows along that way until they agree.
    Args:    covariance (6, 6) by the normal equations. variance [px^2] of one coordinate. best_px2: sum of squares.
             alone: whether there is no other minimum; where there is one, its margin covers it.
    Returns: (6, 6), never smaller than `covariance`.
    Source:  Venzon and Moolgavkar 1988, profile likelihood intervals.
    """
    T = np.ascontiguousarray(T_cam_object, dtype=np.float64)
    wide = _widened_covariance(T, np.ascontiguousarray(covariance), variance, best_px2, kernel_arrays(observations))
    for share in (1.0, 0.5) if alone else ():
        other = mirrored_pose(T, observations.points_object, observations.eye_x_m, share)
        rise = (profile_sum_squares(other, observations) - best_px2) / variance
        if rise < CHI2_RISE_MAX:
            wide = _at_most(wide, pose_difference(T, other), max(rise, 1.0))
    return wide


def _at_most(covariance: Array, apart: Array, chi2: float) -> Array:
    """The covariance grown along the way `apart` (6,) until its rotation says at most this chi2 of it."""
    turn = apart[:3]
    claimed = float(turn @ np.linalg.solve(covariance[:3, :3], turn))
    if claimed <= chi2:
        return covariance
    return covariance + (1.0 / chi2 - 1.0 / claimed) * np.outer(apart, apart)


PRIOR_AGE_MAX_S = 0.5
PRIOR_CHI2_MAX = 16.8  # 6 degrees of freedom, 99 %


@dataclass(frozen=True, slots=True)
class PosePrior:
    """Where the object was in the camera a moment ago, by images alone.

    T_cam_object (4, 4); covariance (6, 6) rotation vector [rad], translation [m]; age_s: how long ago.
    """

    T_cam_object: Array
    covariance: Array
    age_s: float


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


def chi2_to_prior(T_cam_object: Array, covariance: Array, prior: PosePrior, limits: MotionLimits) -> float:
    """How many chi2 (6 degrees of freedom) a pose lies from the prior, plausible motion allowed for."""
    apart = pose_difference(prior.T_cam_object, T_cam_object)
    motion = np.repeat([limits.turn_rate_rad_s * prior.age_s, limits.speed_m_s * prior.age_s], 3)
    return float(apart @ np.linalg.solve(covariance + prior.covariance + np.diag(motion**2), apart))
