"""The joint fit behind teaching: places and sides of all markers, poses of all views, and the baseline's scale."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machine.poses import moved_pose
from server.vision.contracts import Array

Indices = NDArray[np.intp]

ITERATIONS_MAX = 60
CONVERGED_GAIN_FRAC = 1e-10  # of the cost
HUBER_SIGMAS = 3.0
DEPTH_MIN_M = 0.02
UNKNOWNS_PER_MARKER = 7  # rotation vector, translation, side


@dataclass(frozen=True, slots=True)
class Corners:
    """Every corner in every view and eye, one row each: n rows.

    seen_px (n, 2): undistorted, relative to the principal point. unit_corners (n, 3): of a marker of side 1.
    is_right_eye (n,): 1 in the right eye, 0 in the left. sighting_indices (n,): which marker in which view.
    """

    view_indices: Indices
    marker_indices: Indices
    sighting_indices: Indices
    unit_corners: Array
    is_right_eye: Array
    seen_px: Array
    focal_px: Array
    baseline_m: float

    def without_rows(self, dropped: NDArray[np.bool_]) -> "Corners":
        """The rows that are not dropped (n,)."""
        keep = ~dropped
        return replace(
            self,
            view_indices=self.view_indices[keep],
            marker_indices=self.marker_indices[keep],
            sighting_indices=self.sighting_indices[keep],
            unit_corners=self.unit_corners[keep],
            is_right_eye=self.is_right_eye[keep],
            seen_px=self.seen_px[keep],
        )


@dataclass(frozen=True, slots=True)
class LayoutState:
    """Unknowns: T_ref_marker (m, 4, 4), T_cam_ref (v, 4, 4), sides (m,) [m], what the baseline is longer by."""

    Ts_ref_marker: Array
    Ts_cam_ref: Array
    sides_m: Array
    baseline_frac: float


@dataclass(frozen=True, slots=True)
class Priors:
    """What is known besides the images: sides (m,) [m] with sigmas (infinite: unknown), the baseline's own sigma."""

    sides_m: Array
    side_sigmas_m: Array
    baseline_sigma_frac: float
    sigma_px: float


@dataclass(frozen=True, slots=True)
class LayoutFit:
    """The minimum: state, covariance (7 m + 1) of markers and baseline for corners of `sigma_px`, residuals (n, 2)."""

    state: LayoutState
    covariance: Array
    residuals_px: Array


@dataclass(frozen=True, slots=True)
class _ReducedNormalEquations:
    """Normal equations, views eliminated: S x = -g; per-view parts kept for the way back."""

    S: Array
    g: Array
    view_inverse: Array  # (v, 6, 6)
    view_gradient: Array  # (v, 6)
    view_cross_blocks: Array  # (v, 6, k)


def residuals_px(state: LayoutState, corners: Corners) -> Array:
    """Predicted minus seen (n, 2) [px]; infinite where a corner lies behind the glass."""
    p = _in_camera(state, corners)[0]
    z = np.where(p[:, 2] >= DEPTH_MIN_M, p[:, 2], np.nan)
    eye_x = corners.is_right_eye * corners.baseline_m * (1.0 + state.baseline_frac)
    rays = np.column_stack([(p[:, 0] - eye_x) / z, p[:, 1] / z])
    found = rays * corners.focal_px - corners.seen_px
    return np.where(np.isfinite(found), found, np.inf)


def fit_layout(start: LayoutState, corners: Corners, priors: Priors) -> LayoutFit:
    """Robust joint minimum from a start.

    Model:   min sum rho(|pi_eye(T_cam_ref(v) T_ref_marker(m) s_m c) - u|) + sum ((s_m - print) / sigma)^2
             + (b / sigma_b)^2, baseline (1 + b), rho Huber at three sigma (sigma at least `priors.sigma_px`, and as
             large as the residuals' median says); views eliminated by Schur's complement; the reference marker is held.
    """
    state, damping = start, 1e-4
    cost, scale_px = _robust_cost(state, corners, priors)
    for _ in range(ITERATIONS_MAX):
        if not np.isfinite(cost):
            break
        equations = _normal_equations(state, corners, priors, scale_px, damping)
        trial = _solve_and_step(state, equations)
        trial_cost, _ = _robust_cost(trial, corners, priors, scale_px)
        if trial_cost <= cost:
            done = cost - trial_cost <= CONVERGED_GAIN_FRAC * cost + 1e-12
            state, damping = trial, max(0.1 * damping, 1e-9)
            cost, scale_px = _robust_cost(state, corners, priors)
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return LayoutFit(state, _layout_covariance(state, corners, priors), residuals_px(state, corners))


def _in_camera(state: LayoutState, corners: Corners) -> tuple[Array, Array, Array]:
    """Corners in the left camera (n, 3), arms R_cam_ref p_ref (n, 3), and R_ref_marker s c (n, 3)."""
    T_marker, T_view = state.Ts_ref_marker[corners.marker_indices], state.Ts_cam_ref[corners.view_indices]
    on_marker = np.einsum(
        "nij,nj->ni", T_marker[:, :3, :3], state.sides_m[corners.marker_indices, None] * corners.unit_corners
    )
    arm = np.einsum("nij,nj->ni", T_view[:, :3, :3], on_marker + T_marker[:, :3, 3])
    return arm + T_view[:, :3, 3], arm, on_marker


def _robust_cost(
    state: LayoutState, corners: Corners, priors: Priors, scale_px: float | None = None
) -> tuple[float, float]:
    """Robust cost in units of sigma squared, and the scale it was taken at."""
    distance = np.linalg.norm(residuals_px(state, corners), axis=1)
    if not np.isfinite(distance).all() or np.any(state.sides_m <= 0.0):
        return float("inf"), priors.sigma_px
    if scale_px is None:
        scale_px = max(priors.sigma_px, float(np.median(distance)) / 1.1774)  # Rayleigh's median
    limit = HUBER_SIGMAS * scale_px
    rho = np.where(distance <= limit, distance**2, 2.0 * limit * distance - limit**2)
    known = (state.sides_m - priors.sides_m) / priors.side_sigmas_m
    extra = float((known**2).sum()) + (state.baseline_frac / priors.baseline_sigma_frac) ** 2
    return float(rho.sum()) / priors.sigma_px**2 + extra, scale_px


def _residual_jacobians(state: LayoutState, corners: Corners) -> tuple[Array, Array, Array]:
    """d residual / d view (n, 2, 6), / d marker (n, 2, 7), / d baseline (n, 2)."""
    p, arm, on_marker = _in_camera(state, corners)
    eye_x = corners.is_right_eye * corners.baseline_m * (1.0 + state.baseline_frac)
    inverse = 1.0 / p[:, 2]
    P = np.zeros((len(p), 2, 3))
    P[:, 0, 0], P[:, 1, 1] = corners.focal_px[0] * inverse, corners.focal_px[1] * inverse
    P[:, 0, 2] = -P[:, 0, 0] * (p[:, 0] - eye_x) * inverse
    P[:, 1, 2] = -P[:, 1, 1] * p[:, 1] * inverse
    R_view = state.Ts_cam_ref[corners.view_indices][:, :3, :3]
    R_marker = state.Ts_ref_marker[corners.marker_indices][:, :3, :3]
    on_ref = P @ R_view
    J_view = np.concatenate([_cross_rows(P, arm), P], axis=2)
    along_side = np.einsum("nij,njk,nk->ni", on_ref, R_marker, corners.unit_corners)
    J_marker = np.concatenate([_cross_rows(on_ref, on_marker), on_ref, along_side[:, :, None]], axis=2)
    J_baseline = -P[:, :, 0] * (corners.is_right_eye * corners.baseline_m)[:, None]
    return J_view, J_marker, J_baseline


def _cross_rows(P: Array, arm: Array) -> Array:
    """P (-[arm]x), row by row: each row r of P gives arm x r."""
    return np.cross(arm[:, None, :], P)


def _normal_equations(
    state: LayoutState, corners: Corners, priors: Priors, scale_px: float, damping: float
) -> _ReducedNormalEquations:
    n_views, n_markers = len(state.Ts_cam_ref), len(state.Ts_ref_marker)
    k = UNKNOWNS_PER_MARKER * n_markers + 1
    residual = residuals_px(state, corners)
    distance = np.linalg.norm(residual, axis=1)
    weight = np.minimum(1.0, HUBER_SIGMAS * scale_px / np.maximum(distance, 1e-12)) / priors.sigma_px**2
    J_view, J_marker, J_baseline = _residual_jacobians(state, corners)
    V, v = np.zeros((n_views, 6, 6)), np.zeros((n_views, 6))
    C = np.zeros((n_views, n_markers, 6, UNKNOWNS_PER_MARKER))
    M, m = np.zeros((n_markers, UNKNOWNS_PER_MARKER, UNKNOWNS_PER_MARKER)), np.zeros((n_markers, UNKNOWNS_PER_MARKER))
    W, B = np.zeros((n_views, 6)), np.zeros((n_markers, UNKNOWNS_PER_MARKER))
    weighted_view, weighted_marker = J_view * weight[:, None, None], J_marker * weight[:, None, None]
    np.add.at(V, corners.view_indices, np.einsum("nij,nik->njk", weighted_view, J_view))
    np.add.at(v, corners.view_indices, np.einsum("nij,ni->nj", weighted_view, residual))
    np.add.at(C, (corners.view_indices, corners.marker_indices), np.einsum("nij,nik->njk", weighted_view, J_marker))
    np.add.at(M, corners.marker_indices, np.einsum("nij,nik->njk", weighted_marker, J_marker))
    np.add.at(m, corners.marker_indices, np.einsum("nij,ni->nj", weighted_marker, residual))
    np.add.at(W, corners.view_indices, np.einsum("nij,ni->nj", weighted_view, J_baseline))
    np.add.at(B, corners.marker_indices, np.einsum("nij,ni->nj", weighted_marker, J_baseline))
    A, g, cross = np.zeros((k, k)), np.zeros(k), np.zeros((n_views, 6, k))
    for i in range(n_markers):
        rows = slice(UNKNOWNS_PER_MARKER * i, UNKNOWNS_PER_MARKER * (i + 1))
        A[rows, rows], g[rows], A[rows, -1] = M[i], m[i], B[i]
        A[-1, rows], cross[:, :, rows] = B[i], C[:, i]
    A[-1, -1] = float(weight @ (J_baseline**2).sum(axis=1))
    g[-1] = float(weight @ (J_baseline * residual).sum(axis=1))
    cross[:, :, -1] = W
    _add_priors(A, g, state, priors)
    diagonal = np.arange(6)
    V[:, diagonal, diagonal] *= 1.0 + damping
    A[np.diag_indices(k)] *= 1.0 + damping
    view_inverse = np.asarray(np.linalg.inv(V + 1e-9 * np.eye(6)), dtype=np.float64)
    halved = np.einsum("vij,vik->vjk", cross, view_inverse)  # cross^T V^-1
    S = A - np.einsum("vij,vjk->ik", halved, cross)
    return _ReducedNormalEquations(S, g - np.einsum("vij,vj->i", halved, v), view_inverse, v, cross)


def _add_priors(A: Array, g: Array, state: LayoutState, priors: Priors) -> None:
    for i, (side, known, sigma) in enumerate(zip(state.sides_m, priors.sides_m, priors.side_sigmas_m, strict=True)):
        row = UNKNOWNS_PER_MARKER * i + 6
        A[row, row] += 1.0 / sigma**2
        g[row] += (side - known) / sigma**2
    A[-1, -1] += 1.0 / priors.baseline_sigma_frac**2
    g[-1] += state.baseline_frac / priors.baseline_sigma_frac**2


def free_rows(n_markers: int) -> Indices:
    """Which of the 7 m + 1 parameters are free: all but the six of the first marker, the reference."""
    return np.arange(6, UNKNOWNS_PER_MARKER * n_markers + 1)


def stepped_state(state: LayoutState, step: Array) -> LayoutState:
    """The state after a step (7 m + 1) of markers and baseline; views stay."""
    n = len(state.Ts_ref_marker)
    per_marker = step[:-1].reshape(n, UNKNOWNS_PER_MARKER)
    Ts = _all_moved(state.Ts_ref_marker, per_marker[:, :6])
    sides = state.sides_m + per_marker[:, 6]
    return replace(state, Ts_ref_marker=Ts, sides_m=sides, baseline_frac=state.baseline_frac + float(step[-1]))


def _solve_and_step(state: LayoutState, equations: _ReducedNormalEquations) -> LayoutState:
    free = free_rows(len(state.Ts_ref_marker))
    step = np.zeros(len(equations.g))
    step[free] = _solve_scaled_system(equations.S[np.ix_(free, free)], -equations.g[free])
    back = equations.view_gradient + np.einsum("vij,j->vi", equations.view_cross_blocks, step)
    views = -np.einsum("vij,vj->vi", equations.view_inverse, back)
    return replace(stepped_state(state, step), Ts_cam_ref=_all_moved(state.Ts_cam_ref, views))


def _all_moved(Ts: Array, steps: Array) -> Array:
    return np.array([moved_pose(T, step) for T, step in zip(Ts, steps, strict=True)])


def _scale_to_unit_diagonal(S: Array) -> tuple[Array, Array]:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-300))
    return S * np.outer(scale, scale), scale


def _solve_scaled_system(S: Array, right: Array) -> Array:
    scaled, scale = _scale_to_unit_diagonal(S)
    try:
        return scale * np.linalg.solve(scaled + 1e-12 * np.eye(len(S)), scale * right)
    except np.linalg.LinAlgError:
        return np.zeros(len(S))


def _layout_covariance(state: LayoutState, corners: Corners, priors: Priors) -> Array:
    """(7 m + 1, 7 m + 1), zero for what is held; infinite diagonal where nothing is determined."""
    n = len(state.Ts_ref_marker)
    k = UNKNOWNS_PER_MARKER * n + 1
    full, free = np.zeros((k, k)), free_rows(n)
    if not np.isfinite(residuals_px(state, corners)).all():
        return np.diag(np.full(k, np.inf))
    S = _normal_equations(state, corners, priors, np.inf, 0.0).S[np.ix_(free, free)]
    scaled, scale = _scale_to_unit_diagonal(S)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] < 1e-12:
        return np.diag(np.full(k, np.inf))
    full[np.ix_(free, free)] = np.outer(scale, scale) * ((vectors / values) @ vectors.T)
    return full
