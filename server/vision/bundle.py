"""Windowed stereo bundle adjustment: frames and points moved together until the rays fit best."""

from typing import NamedTuple

import numpy as np

from server.vision.bundle_contracts import (
    BundleLayout,
    BundleLoss,
    BundleProblem,
    BundleResult,
    BundleSettings,
    BundleState,
    BundleStatus,
    BundleWork,
    Indices,
    check_shapes,
    kernel_layout_and_start,
    make_work,
)
from server.vision.bundle_covariance import (
    CONVERGED,
    NOT_FINITE,
    BundleFit,
    Spread,
    fit_of,
    frames_spread,
    minimise,
    noise_of,
    seen_counts,
)
from server.vision.bundle_residuals import HUBER, drop_behind, linearise, observations_cost
from server.vision.contracts import Array

UNKNOWN_COVARIANCE = np.diag([np.pi**2] * 3 + [1e6] * 3)


ROTATION_TOL = 1e-6
ABSOLUTE_VALUE_MAX = 1e9  # m, px or rays: beyond, squares lose their digits


def why_degenerate(problem: BundleProblem, layout: BundleLayout, start: BundleState) -> str:
    """A reason why nothing can be adjusted, or an empty string."""
    if len(problem.Ts_vo_cam) == 0 or len(problem.frame_indices) == 0:
        return (
            f"{len(problem.Ts_vo_cam)} frames and {len(problem.frame_indices)} observations; there is nothing to adjust"
        )
    return _bad_numbers(problem, layout, start) or _bad_structure(layout)


def _bad_numbers(problem: BundleProblem, layout: BundleLayout, start: BundleState) -> str:
    if not _is_within_limits(start.rotation) or not _is_within_limits(start.position):
        return "a start pose is not finite"
    off = np.abs(start.rotation @ start.rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    if (off > ROTATION_TOL).any() or (np.linalg.det(start.rotation) < 0.0).any():
        return f"start pose {int(off.argmax())} is not a rotation (off by {off.max():.1e})"
    observed = np.diff(layout.first_observation) > 0
    if not _is_within_limits(start.points[observed]):
        return "the place of an observed point is not finite"
    if not _is_within_limits(layout.rays):
        return "a ray is infinite"
    measured = ~np.isnan(problem.rays[:, 0]), ~np.isnan(problem.rays[:, 2])
    for eye in range(2):
        sigma = problem.sigma_px[measured[eye], min(eye, problem.rays.shape[1] - 3)]
        if not ((sigma > 0.0) & (sigma < ABSOLUTE_VALUE_MAX)).all():
            return "a sigma is not a positive number"
    if not (min(problem.focal_px) > 0.0 and np.isfinite(problem.baseline_m) and problem.baseline_m > 0.0):
        return f"focal lengths {problem.focal_px} px and baseline {problem.baseline_m} m have to be positive"
    return "" if _is_within_limits(layout.focal_over_sigma) else "a sigma is too small for its focal length"


def _is_within_limits(array: Array) -> bool:
    return bool((np.abs(array) < ABSOLUTE_VALUE_MAX).all())


def _bad_structure(layout: BundleLayout) -> str:
    if not (layout.frame_columns < 0).any():
        return "no frame is fixed: everything could move together"
    seen = np.zeros(len(layout.frame_columns), dtype=bool)
    seen[layout.frame_indices[layout.in_front]] = True
    lonely = np.flatnonzero(~seen & (layout.frame_columns >= 0))
    return f"frame {int(lonely[0])} has no observation" if len(lonely) else ""


# Share of an unknown's information that must be its own; rounding leaves about 1e-14 of a gauge
OWN_INFORMATION_MIN_FRAC = 1e-10


def why_not_believed(
    layout: BundleLayout, work: BundleWork, spread: Spread, fit: BundleFit, seen: Indices, settings: BundleSettings
) -> str:
    """A reason why the optimum says nothing about the poses, or an empty string."""
    if fit.redundancy <= 0:
        return f"{-fit.redundancy} measurements too few for the unknowns"
    if not np.isfinite(spread.covariance).all() or (spread.own_frac < OWN_INFORMATION_MIN_FRAC).any():
        weakest = int(spread.own_frac.argmin()) // 6
        return f"{_frame_name(layout, weakest)} is not determined by its observations"
    n_frames = len(layout.frame_columns)
    wanted = np.bincount(layout.frame_indices, (seen > 0).sum(axis=1), minlength=n_frames)
    agreed = np.bincount(layout.frame_indices, fit.inliers.sum(axis=1), minlength=n_frames)
    share = np.where(wanted > 0, agreed / np.maximum(wanted, 1), 1.0)
    share[layout.frame_columns < 0] = 1.0
    worst = int(share.argmin())
    if share[worst] < settings.inliers_min_frac:
        return f"frame {worst}: {agreed[worst]:.0f} of {wanted[worst]:.0f} rays agree with the rest"
    return _too_wide(layout, work, spread, fit, settings)


def _too_wide(layout: BundleLayout, work: BundleWork, spread: Spread, fit: BundleFit, settings: BundleSettings) -> str:
    sigmas = np.sqrt(fit.variance_factor * np.diag(spread.covariance)).reshape(-1, 2, 3).max(axis=2)
    depths = _median_depths(layout, work)
    for frame in np.flatnonzero(layout.frame_columns >= 0):
        rotation, position = sigmas[layout.frame_columns[frame]]
        name = f"frame {frame}"
        if rotation > settings.sigma_rotation_max_rad:
            return f"{name}: sigma of the rotation {np.rad2deg(rotation):.1f} deg; too little is seen"
        if position > settings.sigma_position_max_frac * depths[frame]:
            return f"{name}: sigma of the position {position:.3g} m at {depths[frame]:.3g} m from the points"
    return ""


def _median_depths(layout: BundleLayout, work: BundleWork) -> Array:
    """Median distance of the points that each frame sees (k,); infinite where it sees none."""
    depths = np.full(len(layout.frame_columns), np.inf)
    distance = np.linalg.norm(work.eye_to_point, axis=1)
    for number in range(len(depths)):
        own = (layout.frame_indices == number) & layout.in_front
        if own.any():
            depths[number] = np.median(distance[own])
    return depths


def _frame_name(layout: BundleLayout, column: int) -> str:
    return f"frame {int(np.flatnonzero(layout.frame_columns == column)[0])}"


OUTLIER_ROUNDS_MAX = 4
COARSE_STEP_TOL_SIGMA = 0.5  # per unknown: near enough to find outliers; the slow end of reweighting is saved
COARSE_ITERATIONS_FRAC = 0.5  # of the iterations
NOISE_CONVERGED_FRAC = 0.1  # a noise that changed by less needs no further round


class Adjusted(NamedTuple):
    """How it ended, iterations, costs before and after, up to how many sigmas an eye agrees, what was seen (n, 2), and
    the layout as it was at the end."""

    termination: int
    iterations: int
    cost_before: float
    cost_after: float
    limit_sigma: float
    eye_visibility: Indices
    layout: BundleLayout


def adjust_in_rounds(layout: BundleLayout, state: BundleState, work: BundleWork, settings: BundleSettings) -> Adjusted:
    """Adjust `state` in place; with `trim_outliers`, eyes that disagree leave `layout` and the rest is adjusted again
    with the noise that there is."""
    trial = BundleState(*(array.copy() for array in state))
    seen, iterations_max = seen_counts(layout), settings.iterations_max
    drop_behind(layout, state)
    before = observations_cost(layout, state)[0]
    if not settings.trim_outliers or settings.loss is BundleLoss.NONE:
        ending, spent = minimise(layout, state, trial, work, iterations_max, settings.step_tol_sigma)
        noise, latest = _estimate_noise(layout, state, work), layout
    else:
        # Huber first: far from the optimum Cauchy has other minima, in which good rays are the outliers
        rough, tol = (
            max(1, int(COARSE_ITERATIONS_FRAC * iterations_max)),
            COARSE_STEP_TOL_SIGMA * np.sqrt(_unknown_count(layout)),
        )
        ending, spent = minimise(layout._replace(loss=HUBER), state, trial, work, rough, tol)
        noise, latest, used = _estimate_noise(layout, state, work), layout, 0.0
        everything = layout.focal_over_sigma.copy()
        for _ in range(OUTLIER_ROUNDS_MAX):
            changed = _reselect_inliers(layout, everything, state, work, settings.inlier_sigma * noise)
            if ending == NOT_FINITE or (changed == 0 and abs(noise - used) < NOISE_CONVERGED_FRAC * used):
                break
            used, latest = noise, layout._replace(loss_scale=settings.loss_scale * noise)
            left = iterations_max - spent
            ending, more = minimise(latest, state, trial, work, left, settings.step_tol_sigma)
            spent += more
            noise = _estimate_noise(layout, state, work)
    after = observations_cost(layout, state)[0]
    return Adjusted(ending, spent, before, after, settings.inlier_sigma * noise, seen, latest)


def _unknown_count(layout: BundleLayout) -> int:
    return 6 * layout.n_columns + 3 * (len(layout.first_observation) - 1)


def _estimate_noise(layout: BundleLayout, state: BundleState, work: BundleWork) -> float:
    linearise(layout, state, work)
    return noise_of(layout, work.squared_residuals)


def _reselect_inliers(
    layout: BundleLayout, everything: Array, state: BundleState, work: BundleWork, limit_sigma: float
) -> int:
    """Take eyes that disagree out of `layout`, and those back in that agree by now; how many coordinates changed."""
    before = layout.focal_over_sigma.copy()
    layout.focal_over_sigma[:] = everything
    layout.in_front[:] = (everything > 0.0).any(axis=1)
    drop_behind(layout, state)
    linearise(layout, state, work)
    out = work.squared_residuals > limit_sigma**2
    if layout.shared_row:
        out[:, 1] = out[:, 0]
    layout.focal_over_sigma[np.repeat(out, 2, axis=1)] = 0.0
    layout.in_front[:] &= (layout.focal_over_sigma > 0.0).any(axis=1)
    return int(((layout.focal_over_sigma > 0.0) != (before > 0.0)).sum())


def adjust_bundle(problem: BundleProblem, settings: BundleSettings | None = None) -> BundleResult:
    """Frames and points that fit the rays best, and how well the frames are known.

    Model:   min over T_vo_cam, X of 1/2 sum of rho(|f (pi_eye(T_cam_vo X) - ray) / sigma|^2). Levenberg-Marquardt by
             reweighted least squares, analytic Jacobians, R <- exp(w) R, t <- t + dt in vo axes; points eliminated
             (Schur complement).
    Args:    problem: start, rays, gauge. An observation whose point is nearer than depth_min_m or behind the eye at the
             start is left out. settings: loss, stopping, what is believed.
    Returns: BundleResult. Covariances are those of the inliers at full weight times the variance factor of the loss.
             DEGENERATE with a reason for numbers that determine nothing; never an exception for what they hold.
    Raises:  BundleInputError: arrays whose shapes or indices do not fit together.
    Source:  Triggs et al. 2000, Bundle Adjustment, sections 3.3 and 6.1; Nielsen 1999 for the damping.
    """
    settings = settings or BundleSettings()
    check_shapes(problem)
    layout, start, order = kernel_layout_and_start(problem, settings)
    reason = why_degenerate(problem, layout, start)
    if reason:
        return _degenerate_result(problem, start, reason, 0)
    state, work = BundleState(*(array.copy() for array in start)), make_work(layout)
    done = adjust_in_rounds(layout, state, work, settings)
    if done.termination == NOT_FINITE:
        return _degenerate_result(problem, start, "the cost is not a finite number", done.iterations)
    spread = frames_spread(layout, state, work, done.limit_sigma)
    fit = fit_of(done.layout, work, done.limit_sigma)
    reason = why_not_believed(layout, work, spread, fit, done.eye_visibility, settings)
    if reason:
        return _degenerate_result(problem, start, reason, done.iterations)
    inliers = np.empty(len(order), dtype=np.bool_)
    inliers[order] = fit.inliers.any(axis=1) & ~((done.eye_visibility > 0) & ~fit.inliers).any(axis=1)
    joint = _expand_joint_covariance(layout, spread, fit)
    converged = done.termination == CONVERGED
    return BundleResult(
        status=BundleStatus.OK if converged else BundleStatus.NOT_CONVERGED,
        reason="" if converged else f"not at the optimum after {done.iterations} iterations",
        Ts_vo_cam=_orthonormalised_poses(state),
        points_vo=state.points,
        covariances=np.array([joint[at : at + 6, at : at + 6] for at in range(0, len(joint), 6)]),
        joint_covariance=joint,
        cost_before=done.cost_before,
        cost_after=done.cost_after,
        rms_sigma=fit.rms_sigma,
        variance_factor=fit.variance_factor,
        inliers=inliers,
        iterations=done.iterations,
    )


def _expand_joint_covariance(layout: BundleLayout, spread: Spread, fit: BundleFit) -> Array:
    """Joint covariance of all frames, zeros for the fixed ones."""
    places = np.flatnonzero(np.repeat(layout.frame_columns >= 0, 6))
    joint = np.zeros((6 * len(layout.frame_columns), 6 * len(layout.frame_columns)))
    joint[np.ix_(places, places)] = fit.variance_factor * spread.covariance
    return joint


def _orthonormalised_poses(state: BundleState) -> Array:
    """Frames (k, 4, 4); what rounding did to the rotations is taken out."""
    u, _, vt = np.linalg.svd(state.rotation)
    Ts = np.tile(np.eye(4), (len(state.rotation), 1, 1))
    Ts[:, :3, :3] = u @ vt
    Ts[:, :3, 3] = state.position
    return Ts


def _degenerate_result(problem: BundleProblem, start: BundleState, reason: str, iterations: int) -> BundleResult:
    """The start, of which nothing is known."""
    k = len(problem.Ts_vo_cam)
    return BundleResult(
        status=BundleStatus.DEGENERATE,
        reason=reason,
        Ts_vo_cam=np.array(problem.Ts_vo_cam, dtype=float),
        points_vo=start.points,
        covariances=np.tile(UNKNOWN_COVARIANCE, (k, 1, 1)),
        joint_covariance=np.asarray(np.kron(np.eye(k), UNKNOWN_COVARIANCE), dtype=np.float64),
        cost_before=np.nan,
        cost_after=np.nan,
        rms_sigma=np.nan,
        variance_factor=np.nan,
        inliers=np.zeros(len(problem.frame_indices), dtype=np.bool_),
        iterations=iterations,
    )
