"""What a bundle adjustment is given and what it gives back: frozen, flat arrays, SI units, pixels in the names."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array
from server.vision.errors import VisionError

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


class BundleInputError(VisionError):
    """Arrays of a bundle problem that do not fit together: a wrong shape, or an index that leads nowhere."""


class BundleStatus(Enum):
    """What the result may be used for."""

    OK = "ok"
    NOT_CONVERGED = "not_converged"  # poses are better than the start, but not the optimum
    DEGENERATE = "degenerate"  # the data do not determine the poses: the start comes back, covariances unknown


class BundleLoss(Enum):
    """How the cost grows with a residual; the whole residual of an eye (or of a rectified pair) counts as one."""

    NONE = 0
    HUBER = 1
    CAUCHY = 2


@dataclass(frozen=True, slots=True)
class RigidGroup:
    """Points whose places on one rigid body are known, such as the corners of all markers of the static OOI.

    point_indices (p,): rows of `BundleProblem.points_vo` that belong to the body; what stands there is not used.
    points_group (p, 3) [m]: the same points in the body's axes. T_vo_group (4, 4): start. fixed: the pose is known.
    information (6, 6): prior on the start pose, as `BundleProblem.information`; None = nothing is known.
    """

    point_indices: Indices
    points_group: Array
    T_vo_group: Array
    fixed: bool = False
    information: Array | None = None


@dataclass(frozen=True, slots=True)
class BundleProblem:
    """k frames (left eyes) see m points in n observations; both eyes of a pair are one observation.

    Ts_vo_cam (k, 4, 4): start. points_vo (m, 3) [m]: start.
    frames, points (n,): which frame sees which point.
    uv (n, 4): undistorted rays x/z, y/z: left u, v, right u, v. NaN = that eye does not see it (both columns of it).
        (n, 3): left u, v, right u of a rectified pair, whose row is one measurement of the left eye's sigma; right u
        may be NaN.
    sigma_px (n, 2): of a coordinate, left and right eye.
    focal_px: (fx, fy). baseline_m: the right eye is a pure translation along x.
    fixed (k,): frames whose pose is known (the gauge); their covariance is zero.
    information (k, 6, 6): prior on the start poses: rotation vector [1/rad^2] by left perturbation in vo axes, then
        position [1/m^2]; zeros where nothing is known. None = no priors.
    groups: rigid bodies. fixed_points (m,): points whose place is known; None = none.
    """

    Ts_vo_cam: Array
    points_vo: Array
    frames: Indices
    points: Indices
    uv: Array
    sigma_px: Array
    focal_px: tuple[float, float]
    baseline_m: float
    fixed: Mask
    information: Array | None = None
    groups: Sequence[RigidGroup] = ()
    fixed_points: Mask | None = None


@dataclass(frozen=True, slots=True)
class BundleSettings:
    """Loss, when to stop, and from when on a result is believed."""

    loss: BundleLoss = BundleLoss.HUBER
    loss_scale: float = 2.0  # in sigmas; with `trim` times the noise, where residuals are larger than their sigma
    inlier_sigma: float = 4.0  # an eye's residual beyond this (times the noise, where that is above 1) is an outlier
    trim: bool = True  # leave outliers out and adjust again: a loss lets each of them pull a little (not with NONE)
    iterations_max: int = 50
    step_tol_sigma: float = 1e-2  # stop when no combination of unknowns moves by more than this many of its sigmas
    point_covariances: bool = False
    depth_min_m: float = 0.02  # an observation whose point lies nearer, or behind the eye, is not used
    inliers_min_frac: float = 0.5  # of each free frame's observations
    sigma_rotation_max_rad: float = 0.2  # beyond, a linearised covariance says nothing
    sigma_position_max_frac: float = 0.2  # of the median depth of the frame's points


@dataclass(frozen=True, slots=True)
class BundleResult:
    """The optimum; on DEGENERATE the start with covariances that say that nothing is known.

    Ts_vo_cam (k, 4, 4), points_vo (m, 3) [m], Ts_vo_group (g, 4, 4).
    covariances (k, 6, 6), group_covariances (g, 6, 6): rotation vector [rad] by left perturbation in vo axes, then
        position [m], as `OdometryPose`; of a fixed frame zero.
    joint_covariance (6 (k + g), 6 (k + g)): the same with all that frames and groups have in common.
    point_covariances (m, 3, 3) [m^2], vo axes; (0, 3, 3) unless asked for. A point that nobody sees: 1e6 m^2.
    cost_before, cost_after: sum of rho(r^2 / sigma^2) / 2 at the given loss scale, priors included; after: without what
        was trimmed. rms_sigma: over the inliers' coordinates.
    variance_factor: by which the covariances were multiplied (loss, residuals larger than their sigma).
    inliers (n,): every eye that sees the point agrees with it.
    """

    status: BundleStatus
    reason: str
    Ts_vo_cam: Array
    points_vo: Array
    Ts_vo_group: Array
    covariances: Array
    group_covariances: Array
    joint_covariance: Array
    point_covariances: Array
    cost_before: float
    cost_after: float
    rms_sigma: float
    variance_factor: float
    inliers: Mask
    iterations: int
