"""Windowed stereo bundle adjustment: frames, points and rigid groups moved together until the rays fit best."""

import numpy as np

from server.vision.bundle_check import why_degenerate
from server.vision.bundle_contracts import (
    BundleInputError,
    BundleLoss,
    BundleProblem,
    BundleResult,
    BundleSettings,
    BundleStatus,
    RigidGroup,
)
from server.vision.bundle_covariance import UNOBSERVED_M2, Fit, Spread, bodies_spread, fit_of, points_spread
from server.vision.bundle_layout import (
    BundleLayout,
    BundleState,
    check_shapes,
    make_layout,
    make_work,
)
from server.vision.bundle_levenberg import CONVERGED, NOT_FINITE
from server.vision.bundle_rounds import adjust_in_rounds
from server.vision.bundle_verdict import why_not_believed
from server.vision.contracts import Array

__all__ = [
    "BundleInputError",
    "BundleLoss",
    "BundleProblem",
    "BundleResult",
    "BundleSettings",
    "BundleStatus",
    "RigidGroup",
    "adjust_bundle",
]

UNKNOWN_COVARIANCE = np.diag([np.pi**2] * 3 + [1e6] * 3)


def adjust_bundle(problem: BundleProblem, settings: BundleSettings | None = None) -> BundleResult:
    """Frames, points and groups that fit the rays best, and how well they are known.

    Model:   min over T_vo_cam, X, T_vo_group of 1/2 sum of rho(|f (pi_eye(T_cam_vo X) - ray) / sigma|^2) + 1/2 sum of
             e^T information e, e = (log(R R_start^T), t - t_start). Levenberg-Marquardt by reweighted least squares,
             analytic Jacobians, R <- exp(w) R, t <- t + dt in vo axes; points eliminated (Schur complement).
    Args:    problem: start, rays, gauge. An observation whose point is nearer than depth_min_m or behind the eye at the
             start is left out. settings: loss, stopping, what is believed.
    Returns: BundleResult. Covariances are those of the inliers at full weight times the variance factor of the loss.
             DEGENERATE with a reason for numbers that determine nothing; never an exception for what they hold.
    Raises:  BundleInputError: arrays whose shapes or indices do not fit together.
    Source:  Triggs et al. 2000, Bundle Adjustment, sections 3.3 and 6.1; Nielsen 1999 for the damping.
    """
    settings = settings or BundleSettings()
    check_shapes(problem)
    layout, start, order = make_layout(problem, settings)
    reason = why_degenerate(problem, layout, start)
    if reason:
        return _unknown(problem, start, reason, 0)
    state, work = BundleState(*(array.copy() for array in start)), make_work(layout)
    done = adjust_in_rounds(layout, start, state, work, settings)
    if done.ending == NOT_FINITE:
        return _unknown(problem, start, "the cost is not a finite number", done.iterations)
    spread = bodies_spread(layout, start, state, work, done.limit_sigma)
    fit = fit_of(done.layout, work, done.limit_sigma)
    reason = why_not_believed(layout, work, spread, fit, done.seen, len(problem.Ts_vo_cam), settings)
    if reason:
        return _unknown(problem, start, reason, done.iterations)
    inliers = np.empty(len(order), dtype=np.bool_)
    inliers[order] = fit.agree.any(axis=1) & ~((done.seen > 0) & ~fit.agree).any(axis=1)
    joint = _expanded(layout, spread, fit)
    n_frames = len(problem.Ts_vo_cam)
    blocks = np.array([joint[6 * body : 6 * body + 6, 6 * body : 6 * body + 6] for body in range(len(layout.column))])
    point_covariances = np.zeros((len(layout.body) if settings.point_covariances else 0, 3, 3))
    if settings.point_covariances:
        points_spread(layout, work, spread.covariance, point_covariances)
        point_covariances *= fit.variance_factor
    Ts = _poses(state)
    converged = done.ending == CONVERGED
    return BundleResult(
        status=BundleStatus.OK if converged else BundleStatus.NOT_CONVERGED,
        reason="" if converged else f"not at the optimum after {done.iterations} iterations",
        Ts_vo_cam=Ts[:n_frames],
        points_vo=state.points,
        Ts_vo_group=Ts[n_frames:],
        covariances=blocks[:n_frames],
        group_covariances=blocks[n_frames:],
        joint_covariance=joint,
        point_covariances=point_covariances,
        cost_before=done.cost_before,
        cost_after=done.cost_after,
        rms_sigma=fit.rms_sigma,
        variance_factor=fit.variance_factor,
        inliers=inliers,
        iterations=done.iterations,
    )


def _expanded(layout: BundleLayout, spread: Spread, fit: Fit) -> Array:
    """Joint covariance of all bodies, zeros for the fixed ones."""
    places = np.flatnonzero(np.repeat(layout.column >= 0, 6))
    joint = np.zeros((6 * len(layout.column), 6 * len(layout.column)))
    joint[np.ix_(places, places)] = fit.variance_factor * spread.covariance
    return joint


def _poses(state: BundleState) -> Array:
    """Bodies (b, 4, 4); what rounding did to the rotations is taken out."""
    u, _, vt = np.linalg.svd(state.rotation)
    Ts = np.tile(np.eye(4), (len(state.rotation), 1, 1))
    Ts[:, :3, :3] = u @ vt
    Ts[:, :3, 3] = state.position
    return Ts


def _unknown(problem: BundleProblem, start: BundleState, reason: str, iterations: int) -> BundleResult:
    """The start, of which nothing is known."""
    k, g, m = len(problem.Ts_vo_cam), len(problem.groups), len(problem.points_vo)
    unknown = np.tile(UNKNOWN_COVARIANCE, (k + g, 1, 1))
    return BundleResult(
        status=BundleStatus.DEGENERATE,
        reason=reason,
        Ts_vo_cam=np.array(problem.Ts_vo_cam, dtype=float),
        points_vo=start.points,
        Ts_vo_group=np.array([group.T_vo_group for group in problem.groups], dtype=float).reshape(g, 4, 4),
        covariances=unknown[:k],
        group_covariances=unknown[k:],
        joint_covariance=np.asarray(np.kron(np.eye(k + g), UNKNOWN_COVARIANCE), dtype=np.float64),
        point_covariances=np.tile(UNOBSERVED_M2 * np.eye(3), (m, 1, 1)),
        cost_before=np.nan,
        cost_after=np.nan,
        rms_sigma=np.nan,
        variance_factor=np.nan,
        inliers=np.zeros(len(problem.frames), dtype=np.bool_),
        iterations=iterations,
    )
