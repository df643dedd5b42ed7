"""What a bundle adjustment is given and what it gives back: frozen, flat arrays, SI units, pixels in the names."""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array
from server.vision.errors import VisionError

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


# Named tuples where compiled kernels take them: numba does not take dataclasses.

# Information on a point's direction and relative depth: sigma 1000, so that no point block is singular
POINT_PRIOR_INFORMATION = 1e-6


class BundleWork(NamedTuple):
    """Arrays that are written again in every iteration.

    observation_information (n, 6): sum over its rows of w b b^T, b = d residual / d point (xx, yy, zz, xy, yz, zx);
    observation_gradient (n, 3): sum of w b r. eye_to_point (n, 3). squared_residuals (n, 2): of either eye.
    point_chart (m, 3, 3): d point / d (direction, relative inverse depth). point_cholesky (m, 3, 3): factor of the
    point's block in the chart. point_damping (m, 3): what was added to its diagonal. anchor_frames (m,): the frame the
    chart is taken in. reduced_matrix (c, c), reduced_rhs (c,), reduced_diagonal (c,): the camera system.
    point_frame_blocks (longest track, 3, 6), point_frame_columns (longest track,): one point's.
    point_step (m, 3): in the chart.
    """

    observation_information: Array
    observation_gradient: Array
    eye_to_point: Array
    squared_residuals: Array
    point_chart: Array
    point_cholesky: Array
    point_damping: Array
    anchor_frames: Indices
    reduced_matrix: Array
    reduced_rhs: Array
    reduced_diagonal: Array
    point_frame_blocks: Array
    point_step: Array
    point_frame_columns: Indices


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
class BundleProblem:
    """k frames (left eyes) see m points in n observations; both eyes of a pair are one observation.

    Ts_vo_cam (k, 4, 4): start. points_vo (m, 3) [m]: start.
    frame_indices, point_indices (n,): which frame sees which point.
    rays (n, 4): undistorted, x/z, y/z: left u, v, right u, v. NaN = that eye does not see it (both columns of it).
        (n, 3): left u, v, right u of a rectified pair, whose row is one measurement of the left eye's sigma; right u
        may be NaN.
    sigma_px (n, 2): of a coordinate, left and right eye.
    focal_px: (fx, fy). baseline_m: the right eye is a pure translation along x.
    fixed_frames (k,): whose pose is known (the gauge); their covariance is zero.
    """

    Ts_vo_cam: Array
    points_vo: Array
    frame_indices: Indices
    point_indices: Indices
    rays: Array
    sigma_px: Array
    focal_px: tuple[float, float]
    baseline_m: float
    fixed_frames: Mask


@dataclass(frozen=True, slots=True)
class BundleSettings:
    """Loss, when to stop, and from when on a result is believed."""

    loss: BundleLoss = BundleLoss.HUBER
    loss_scale: float = 2.0  # in sigmas; with `trim_outliers` times the noise, where residuals exceed their sigma
    inlier_sigma: float = 4.0  # an eye's residual beyond this (times the noise, where that is above 1) is an outlier
    # Leave outliers out and adjust again: a loss lets each of them pull a little (not with NONE)
    trim_outliers: bool = True
    iterations_max: int = 50
    step_tol_sigma: float = 1e-2  # stop when no combination of unknowns moves by more than this many of its sigmas
    depth_min_m: float = 0.02  # an observation whose point lies nearer, or behind the eye, is not used
    inliers_min_frac: float = 0.5  # of each free frame's observations
    sigma_rotation_max_rad: float = 0.2  # beyond, a linearised covariance says nothing
    sigma_position_max_frac: float = 0.2  # of the median depth of the frame's points


@dataclass(frozen=True, slots=True)
class BundleResult:
    """The optimum; on DEGENERATE the start with covariances that say that nothing is known.

    Ts_vo_cam (k, 4, 4), points_vo (m, 3) [m].
    covariances (k, 6, 6): rotation vector [rad] by left perturbation in vo axes, then position [m], as `OdometryPose`;
        of a fixed frame zero. joint_covariance (6 k, 6 k): the same with all that frames have in common.
    cost_before, cost_after: sum of rho(r^2 / sigma^2) / 2 at the given loss_scale; cost_after without what was trimmed.
    rms_sigma: over the inliers' coordinates.
    variance_factor: by which the covariances were multiplied (loss, residuals larger than their sigma).
    inliers (n,): every eye that sees the point agrees with it.
    """

    status: BundleStatus
    reason: str
    Ts_vo_cam: Array
    points_vo: Array
    covariances: Array
    joint_covariance: Array
    cost_before: float
    cost_after: float
    rms_sigma: float
    variance_factor: float
    inliers: Mask
    iterations: int


class BundleState(NamedTuple):
    """What is adjusted: frames (k, 3, 3), (k, 3) and points (m, 3), all in vo."""

    rotation: Array
    position: Array
    points: Array


class BundleLayout(NamedTuple):
    """What does not change during an adjustment, but for `in_front` (observations whose point is in front of the eye).

    frame_columns (k,): a frame's block in the reduced system, -1 = fixed. first_observation (m + 1,): a point's
    observations are first_observation[p] to first_observation[p + 1]. focal_over_sigma (n, 4): 0 = not seen.
    """

    frame_indices: Indices
    first_observation: Indices
    rays: Array
    focal_over_sigma: Array
    in_front: Mask
    shared_row: bool
    baseline: float
    depth_min: float
    frame_columns: Indices
    n_columns: int
    loss: int
    loss_scale: float


def check_shapes(problem: BundleProblem) -> None:
    """Raise BundleInputError where arrays do not fit together."""
    k, m, n = len(problem.Ts_vo_cam), len(problem.points_vo), len(problem.frame_indices)
    wanted = {
        "Ts_vo_cam": (problem.Ts_vo_cam, (k, 4, 4)),
        "points_vo": (problem.points_vo, (m, 3)),
        "points": (problem.point_indices, (n,)),
        "uv": (problem.rays, (n, 3) if problem.rays.ndim == 2 and problem.rays.shape[1] == 3 else (n, 4)),
        "sigma_px": (problem.sigma_px, (n, 2)),
        "fixed": (problem.fixed_frames, (k,)),
    }
    for name, (array, shape) in wanted.items():
        if array.shape != shape:
            raise BundleInputError(f"{name} has shape {array.shape}; {shape} is needed")
    for name, indices, limit in (("frames", problem.frame_indices, k), ("points", problem.point_indices, m)):
        whole = np.issubdtype(indices.dtype, np.integer)
        if n and not (whole and 0 <= indices.min() <= indices.max() < limit):
            raise BundleInputError(f"{name} has to hold whole numbers from 0 to {limit - 1}")


def _rays_and_seen_mask(problem: BundleProblem) -> tuple[Array, Mask]:
    """Rays (n, 4) with 0 where an eye does not see the point, and which coordinates are measured (n, 4)."""
    uv = np.full((len(problem.frame_indices), 4), np.nan)
    uv[:, : problem.rays.shape[1]] = problem.rays
    seen = ~np.isnan(uv)
    seen[:, :2] &= seen[:, :2].all(axis=1, keepdims=True)
    if problem.rays.shape[1] == 4:
        seen[:, 2:] &= seen[:, 2:].all(axis=1, keepdims=True)
    return np.where(seen, uv, 0.0), seen


def kernel_layout_and_start(
    problem: BundleProblem, settings: BundleSettings
) -> tuple[BundleLayout, BundleState, Indices]:
    """Layout and start, and the order (n,) in which the observations were sorted."""
    order = np.argsort(problem.point_indices, kind="stable")
    rays, seen = _rays_and_seen_mask(problem)
    focal = np.array(problem.focal_px, dtype=float)
    with np.errstate(all="ignore"):
        scale = np.tile(focal, 2) / np.repeat(problem.sigma_px, 2, axis=1)
    unknown = ~problem.fixed_frames
    layout = BundleLayout(
        frame_indices=np.ascontiguousarray(problem.frame_indices[order], dtype=np.int64),
        first_observation=np.searchsorted(problem.point_indices[order], np.arange(len(problem.points_vo) + 1)).astype(
            np.int64
        ),
        rays=np.ascontiguousarray(rays[order]),
        focal_over_sigma=np.ascontiguousarray(np.where(seen, scale, 0.0)[order]),
        in_front=np.ascontiguousarray(np.asarray(seen.any(axis=1))[order]),
        shared_row=problem.rays.shape[1] == 3,
        baseline=float(problem.baseline_m),
        depth_min=float(settings.depth_min_m),
        frame_columns=np.where(unknown, np.cumsum(unknown) - 1, -1).astype(np.int64),
        n_columns=int(unknown.sum()),
        loss=settings.loss.value,
        loss_scale=float(settings.loss_scale),
    )
    Ts = np.asarray(problem.Ts_vo_cam, dtype=float)
    rotation, position = np.ascontiguousarray(Ts[:, :3, :3]), np.ascontiguousarray(Ts[:, :3, 3])
    return layout, BundleState(rotation, position, np.array(problem.points_vo, dtype=float)), order


def make_work(layout: BundleLayout) -> BundleWork:
    """Room for one adjustment."""
    n, m, c = len(layout.frame_indices), len(layout.first_observation) - 1, 6 * layout.n_columns
    longest = int(np.diff(layout.first_observation).max(initial=1))
    return BundleWork(
        observation_information=np.zeros((n, 6)),
        observation_gradient=np.zeros((n, 3)),
        eye_to_point=np.zeros((n, 3)),
        squared_residuals=np.zeros((n, 2)),
        point_chart=np.zeros((m, 3, 3)),
        point_cholesky=np.zeros((m, 3, 3)),
        point_damping=np.zeros((m, 3)),
        anchor_frames=np.full(m, -1, dtype=np.int64),
        reduced_matrix=np.zeros((c, c)),
        reduced_rhs=np.zeros(c),
        reduced_diagonal=np.zeros(c),
        point_frame_blocks=np.zeros((longest, 3, 6)),
        point_step=np.zeros((m, 3)),
        point_frame_columns=np.zeros(longest, dtype=np.int64),
    )
