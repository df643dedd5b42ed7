"""Motion between pairs: prediction, the velocity during a rolling shutter, and the covariance of the inverse pose."""

from dataclasses import dataclass

import numpy as np

from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec, rotvec_from_rotation, skew
from server.vision.contracts import Array

GAP_STEP_RATIO_MAX = 4.0  # a longer gap than this many steps ends the motion's history
FRAME_GAP_MAX_NS = 400_000_000  # over a longer gap a mean velocity says nothing about the present one
TYPICAL_ACCELERATION = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])  # typical [rad/s^2, m/s^2] of a boom that sways
UNKNOWN_TWIST_SIGMA = np.array([0.1, 0.1, 0.1, 0.15, 0.15, 0.15])  # sigma [rad/s, m/s] where nothing is known
VELOCITY_LAG_FRAC = 0.25  # of acceleration times step: what extrapolation leaves of a velocity's lag


@dataclass(frozen=True, slots=True)
class Twist:
    """Velocity of the camera in its own axes (6,): [rad/s], then [m/s]; and its sigma (6,)."""

    velocity: Array
    sigma: Array


@dataclass(frozen=True, slots=True)
class Motion:
    """The last known pose T_vo_cam, the step T_before_last that led to it in step_ns, and its mean velocity."""

    T_vo_cam: Array
    t_ns: int
    T_before_last: Array
    step_ns: int
    mean_before: Array | None  # mean velocity of the step before
    step_before_ns: int

    def predict_pose_at(self, t_ns: int) -> Array:
        """T_vo_cam at a time if the last motion goes on."""
        return predict_pose(self.T_vo_cam, self.T_before_last, self.step_ns, t_ns - self.t_ns)

    def is_gap(self, t_ns: int) -> bool:
        """Whether so long after the last pose no motion is carried on."""
        elapsed_ns = t_ns - self.t_ns
        return elapsed_ns > FRAME_GAP_MAX_NS or 0 < GAP_STEP_RATIO_MAX * self.step_ns < elapsed_ns

    def moved_to(self, T_vo_cam: Array, t_ns: int) -> "Motion":
        """The motion after another pose became known."""
        known = 0 < self.step_ns < FRAME_GAP_MAX_NS
        mean = mean_twist(self.T_before_last, self.step_ns) if known else None
        step = inverse_pose(self.T_vo_cam) @ T_vo_cam
        return Motion(T_vo_cam, t_ns, step, t_ns - self.t_ns, mean, self.step_ns)

    @property
    def is_velocity_known(self) -> bool:
        """Whether the velocity is well known: the last two steps were short enough to show it and its change."""
        return 0 < self.step_ns < FRAME_GAP_MAX_NS and self.mean_before is not None

    def twist(self) -> Twist:
        """Velocity at the last pose: the last step's mean, carried on by half a step with the change since before."""
        if not 0 < self.step_ns < FRAME_GAP_MAX_NS:
            return Twist(np.zeros(6), UNKNOWN_TWIST_SIGMA)
        mean = mean_twist(self.T_before_last, self.step_ns)
        sigma = VELOCITY_LAG_FRAC * 1e-9 * self.step_ns * TYPICAL_ACCELERATION
        if self.mean_before is None:
            return Twist(mean, 2.0 * sigma)
        change = (mean - self.mean_before) / (0.5 * (self.step_ns + self.step_before_ns))
        return Twist(mean + change * 0.5 * self.step_ns, sigma)

    def twist_between(self, after: "Motion") -> Twist:
        """Velocity at this pose, now that the next one is known: the mean of both steps, each counted by the other."""
        if not 0 < after.step_ns < FRAME_GAP_MAX_NS:
            return self.twist()
        following = mean_twist(after.T_before_last, after.step_ns)
        sigma = VELOCITY_LAG_FRAC * 1e-9 * after.step_ns * TYPICAL_ACCELERATION
        if not 0 < self.step_ns < FRAME_GAP_MAX_NS:
            return Twist(following, 2.0 * sigma)
        before = mean_twist(self.T_before_last, self.step_ns)
        share = self.step_ns / (self.step_ns + after.step_ns)
        return Twist(share * following + (1.0 - share) * before, sigma)


def standing_motion(T_vo_cam: Array, t_ns: int) -> Motion:
    """A pose without a past."""
    return Motion(T_vo_cam, t_ns, np.eye(4), 0, None, 0)


def mean_twist(step: Array, step_ns: int) -> Array:
    """Mean velocity (6,) of a step."""
    return np.concatenate([rotvec_from_rotation(step[:3, :3]), step[:3, 3]]) * (1e9 / step_ns)


def predict_pose(T_vo_cam: Array, step: Array, step_ns: int, elapsed_ns: int) -> Array:
    """T_vo_cam after `elapsed_ns` if the last motion goes on; the same pose where the times make no sense.

    Args:    T_vo_cam: last pose. step: last motion T_before_last, which took step_ns.
    """
    ratio = elapsed_ns / step_ns if step_ns > 0 and elapsed_ns > 0 else 0.0
    if ratio > GAP_STEP_RATIO_MAX:
        ratio = 0.0
    rotation = rotation_from_rotvec(ratio * rotvec_from_rotation(step[:3, :3]))
    return T_vo_cam @ pose(rotation, ratio * step[:3, 3])


def row_fractions(rows_px: Array, height_px: int) -> Array:
    """Where rows (n,) lie in the readout: -0.5 the first, 0 the middle, 0.5 the last."""
    return rows_px / (height_px - 1) - 0.5


def moved_by_twist(points_cam: Array, twist: Array, times_s: Array) -> Array:
    """Still points (n, 3), seen from a camera that goes with `twist`, after the times (n,) (first order).

    Model:   x_cam(t) = x_cam - t (w x x_cam + v).
    """
    return points_cam - times_s[:, None] * (points_cam @ skew(twist[:3]).T + twist[3:])


def inverse_jacobian(T_cam_vo: Array) -> Array:
    """(6, 6): the perturbation (w, dt) of T_cam_vo as one of T_vo_cam, both left, rotation first.

    Model:   R <- exp(w) R, t <- t + dt of T_cam_vo gives T_vo_cam the left perturbation -R^T w and the translation
             -R^T (dt + [t]x w).
    """
    R_vo_cam = T_cam_vo[:3, :3].T
    J = np.zeros((6, 6))
    J[:3, :3] = -R_vo_cam
    J[3:, :3] = -R_vo_cam @ skew(T_cam_vo[:3, 3])
    J[3:, 3:] = -R_vo_cam
    return J


def covariance_in_vo(T_cam_vo: Array, covariance: Array) -> Array:
    """Covariance of T_vo_cam from that of its inverse.

    Args:    T_cam_vo (4, 4); covariance (6, 6) of (w, dt) in camera axes.
    Returns: (6, 6), rotation [rad] then translation [m], in vo axes.
    """
    J = inverse_jacobian(T_cam_vo)
    return J @ covariance @ J.T


def with_scale_error(covariance: Array, position_vo: Array, sigma_scale_frac: float) -> Array:
    """Covariance (6, 6) with the rig's unknown scale: sigma_scale_frac times the way from the start, along that way."""
    grown = covariance.copy()
    grown[3:, 3:] += sigma_scale_frac**2 * np.outer(position_vo, position_vo)
    return grown
