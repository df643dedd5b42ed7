"""What a bundle adjustment is given and what it gives back: frozen, flat arrays, SI units, pixels in the names."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array
from server.vision.errors import VisionError

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


# A bundle problem as the compiled kernels want it: observations sorted by point, bodies in one list, no NaN.
#
# Named tuples instead of dataclasses: these are what numba takes apart at the border of compiled code.

PRIOR = 1e-6  # information on a point's direction and relative depth: sigma 1000, so that no point block is singular


class BundleWork(NamedTuple):
    """Arrays that are written again in every iteration.

    weight (n, 6): sum over an observation's rows of w b b^T, b = d residual / d point (xx, yy, zz, xy, yz, zx);
    pull (n, 3): sum of w b r. arm (n, 3): point minus eye. squares (n, 2): residual^2 of either eye.
    chart (m, 3, 3): d point / d (direction, relative inverse depth). lower (m, 3, 3): Cholesky factor of the point's
    block in the chart. damped (m, 3): what was added to its diagonal. anchor (m,): the frame the chart is taken in.
    reduced (c, c), right (c,), diagonal (c,): the camera system. rows (longest track, 3, 6),
    columns (longest track,): one point's. body_arm (m, 3): a group's point minus the group's origin.
    """

    weight: Array
    pull: Array
    arm: Array
    squares: Array
    chart: Array
    lower: Array
    damped: Array
    anchor: Indices
    reduced: Array
    right: Array
    diagonal: Array
    rows: Array
    point_step: Array
    columns: Indices
    body_arm: Array


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
    point_covariances (m, 3, 3) [m^2], vo axes; (0, 3, 3) unless requested. A point that no frame sees: 1e6 m^2.
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


class BundleState(NamedTuple):
    """What is adjusted: bodies (b, 3, 3), (b, 3) and points (m, 3), all in vo."""

    rotation: Array
    position: Array
    points: Array


class BundleLayout(NamedTuple):
    """What does not change during an adjustment, but for `alive` (observations whose point is in front of the eye).

    Bodies are the frames, then the groups. column (b,): a body's block in the reduced system, -1 = fixed.
    first (m + 1,): a point's observations are first[p] to first[p + 1]. scale (n, 4): focal / sigma, 0 = not seen.
    body (m,): the group of a point, -1 = none. in_body (m, 3): its place there. free (m,): its place is unknown.
    """

    frame: Indices
    first: Indices
    rays: Array
    scale: Array
    alive: Mask
    joint: bool
    baseline: float
    depth_min: float
    column: Indices
    n_columns: int
    body: Indices
    in_body: Array
    free: Mask
    information: Array
    has_prior: Mask
    loss: int
    loss_scale: float


def check_shapes(problem: BundleProblem) -> None:
    """Raise BundleInputError where arrays do not fit together."""
    k, m, n = len(problem.Ts_vo_cam), len(problem.points_vo), len(problem.frames)
    wanted = {
        "Ts_vo_cam": (problem.Ts_vo_cam, (k, 4, 4)),
        "points_vo": (problem.points_vo, (m, 3)),
        "points": (problem.points, (n,)),
        "uv": (problem.uv, (n, 3) if problem.uv.ndim == 2 and problem.uv.shape[1] == 3 else (n, 4)),
        "sigma_px": (problem.sigma_px, (n, 2)),
        "fixed": (problem.fixed, (k,)),
        "information": (problem.information, (k, 6, 6)),
        "fixed_points": (problem.fixed_points, (m,)),
    }
    for number, group in enumerate(problem.groups):
        p = len(group.point_indices)
        wanted[f"groups[{number}].points_group"] = (group.points_group, (p, 3))
        wanted[f"groups[{number}].T_vo_group"] = (group.T_vo_group, (4, 4))
        wanted[f"groups[{number}].information"] = (group.information, (6, 6))
    for name, (array, shape) in wanted.items():
        if array is not None and array.shape != shape:
            raise BundleInputError(f"{name} has shape {array.shape}; {shape} is needed")
    _check_indices("frames", problem.frames, k)
    _check_indices("points", problem.points, m)
    for number, group in enumerate(problem.groups):
        _check_indices(f"groups[{number}].point_indices", group.point_indices, m)
    grouped = np.concatenate([np.zeros(0, np.int64), *(group.point_indices for group in problem.groups)])
    if len(np.unique(grouped)) < len(grouped):
        raise BundleInputError("a point belongs to two rigid groups, or twice to one; give it once")


def seen_rays(problem: BundleProblem) -> tuple[Array, Mask]:
    """Rays (n, 4) with 0 where an eye does not see the point, and which coordinates are measured (n, 4)."""
    uv = np.full((len(problem.frames), 4), np.nan)
    uv[:, : problem.uv.shape[1]] = problem.uv
    seen = ~np.isnan(uv)
    seen[:, :2] &= seen[:, :2].all(axis=1, keepdims=True)
    if problem.uv.shape[1] == 4:
        seen[:, 2:] &= seen[:, 2:].all(axis=1, keepdims=True)
    return np.where(seen, uv, 0.0), seen


def make_layout(problem: BundleProblem, settings: BundleSettings) -> tuple[BundleLayout, BundleState, Indices]:
    """Layout and start, and the order (n,) in which the observations were sorted."""
    order = np.argsort(problem.points, kind="stable")
    rays, seen = seen_rays(problem)
    focal = np.array(problem.focal_px, dtype=float)
    with np.errstate(all="ignore"):
        scale = np.tile(focal, 2) / np.repeat(problem.sigma_px, 2, axis=1)
    k, m = len(problem.Ts_vo_cam), len(problem.points_vo)
    body, in_body = np.full(m, -1, dtype=np.int64), np.zeros((m, 3))
    free = np.ones(m, dtype=np.bool_) if problem.fixed_points is None else ~problem.fixed_points
    for number, group in enumerate(problem.groups):
        body[group.point_indices] = k + number
        in_body[group.point_indices] = group.points_group
        free[group.point_indices] = False
    information, has_prior = _priors(problem)
    unknown = np.concatenate([~problem.fixed, np.array([not group.fixed for group in problem.groups], dtype=np.bool_)])
    layout = BundleLayout(
        frame=np.ascontiguousarray(problem.frames[order], dtype=np.int64),
        first=np.searchsorted(problem.points[order], np.arange(m + 1)).astype(np.int64),
        rays=np.ascontiguousarray(rays[order]),
        scale=np.ascontiguousarray(np.where(seen, scale, 0.0)[order]),
        alive=np.ascontiguousarray(np.asarray(seen.any(axis=1))[order]),
        joint=problem.uv.shape[1] == 3,
        baseline=float(problem.baseline_m),
        depth_min=float(settings.depth_min_m),
        column=np.where(unknown, np.cumsum(unknown) - 1, -1).astype(np.int64),
        n_columns=int(unknown.sum()),
        body=body,
        in_body=in_body,
        free=free,
        information=information,
        has_prior=has_prior & unknown,
        loss=settings.loss.value,
        loss_scale=float(settings.loss_scale),
    )
    return layout, _start(problem), order


def _priors(problem: BundleProblem) -> tuple[Array, Mask]:
    k = len(problem.Ts_vo_cam)
    information = np.zeros((k + len(problem.groups), 6, 6))
    if problem.information is not None:
        information[:k] = problem.information
    for number, group in enumerate(problem.groups):
        if group.information is not None:
            information[k + number] = group.information
    return information, np.asarray(information.any(axis=(1, 2)))


def _start(problem: BundleProblem) -> BundleState:
    groups = [np.asarray(group.T_vo_group, dtype=float)[None] for group in problem.groups]
    Ts = np.concatenate([np.asarray(problem.Ts_vo_cam, dtype=float), *groups])
    points = np.array(problem.points_vo, dtype=float)
    for group in problem.groups:
        T = group.T_vo_group
        points[group.point_indices] = group.points_group @ T[:3, :3].T + T[:3, 3]
    return BundleState(np.ascontiguousarray(Ts[:, :3, :3]), np.ascontiguousarray(Ts[:, :3, 3]), points)


def make_work(layout: BundleLayout) -> BundleWork:
    """Room for one adjustment."""
    n, m, c = len(layout.frame), len(layout.body), 6 * layout.n_columns
    longest = int(np.diff(layout.first).max(initial=1))
    return BundleWork(
        weight=np.zeros((n, 6)),
        pull=np.zeros((n, 3)),
        arm=np.zeros((n, 3)),
        squares=np.zeros((n, 2)),
        chart=np.zeros((m, 3, 3)),
        lower=np.zeros((m, 3, 3)),
        damped=np.zeros((m, 3)),
        anchor=np.full(m, -1, dtype=np.int64),
        reduced=np.zeros((c, c)),
        right=np.zeros(c),
        diagonal=np.zeros(c),
        rows=np.zeros((longest, 3, 6)),
        point_step=np.zeros((m, 3)),
        columns=np.zeros(longest, dtype=np.int64),
        body_arm=np.zeros((m, 3)),
    )


def _check_indices(name: str, indices: Indices, limit: int) -> None:
    if len(indices) and not (np.issubdtype(indices.dtype, np.integer) and 0 <= indices.min() <= indices.max() < limit):
        raise BundleInputError(f"{name} has to hold whole numbers from 0 to {limit - 1}")
