"""The line-equation method, improved: one robust fit over all samples instead of the one that seems nearest.

While the TCP moves by c in its plane, the tool-to-OOI vector in the camera falls by the same step, turned by one
unknown angle. All samples together give that angle and the vector at the start; where the vector is zero is the goal.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from machine.poses import pose
from server.calibration.checks import CalibrationInputError, require_pose, require_rotation, require_track
from server.calibration.chords import positions_at
from server.calibration.contracts import Array, CalibrationStatus, EncoderTrack

METHOD_NAME = "line_fit"
_ROUNDS = 15
_MAD_TO_SIGMA_2D = 1.0 / 1.1774  # median of a Rayleigh distribution
_SIGMA_FLOOR_M = 1e-5


@dataclass(frozen=True, slots=True)
class LineFitSettings:
    """What a fit needs, what it is believed up to, and what no residual shows."""

    samples_min: int = 6
    spread_min_m: float = 0.04  # root mean square of the positions across their long axis
    residual_max_m: float = 0.02
    inliers_min_frac: float = 0.6
    from_nominal_max_rad: float = float(np.deg2rad(25.0))
    scale_error_max_frac: float = 0.10
    sigma_scale_frac: float = 0.01  # prior: printed size, focal length, tilt of the image plane
    sigma_model_rad: float = float(np.deg2rad(0.25))  # kinematics and bending
    sigma_floor_m: float = 0.001


@dataclass(frozen=True, slots=True)
class LineFit:
    """The goal in the plane of motion.

    `T_base_tcp_ref` (4, 4) and `covariance` (2, 2) [m^2] of its place along n and s of the start are None unless the
    status is OK. `turn_rad` +- `sigma_turn_rad`: viewing axes against nominal, about their own z. `scale`: seen
    over driven. `residuals_m` (n, 2), NaN where nothing was seen; `weights` (n,) 0..1.
    """

    status: CalibrationStatus
    reason: str
    T_base_tcp_ref: Array | None
    covariance: Array | None
    turn_rad: float
    sigma_turn_rad: float
    scale: float
    residuals_m: Array
    weights: Array
    sigma_m: float


@dataclass(frozen=True, slots=True)
class _SeenDrivenSamples:
    """Seen vectors m and driven positions, turned into the nominal image axes, both (k, 2) [m]."""

    seen_vectors_m: Array
    driven_positions_m: Array


@dataclass(frozen=True, slots=True)
class _Similarity:
    """m = m0 - driven turned by `angle_rad` and scaled; residuals (k, 2), their robust one-axis sigma."""

    translation_m: Array
    angle_rad: float
    scale: float
    weights: Array = field(repr=False)
    residuals: Array = field(repr=False)
    sigma_m: float


def fit_line(
    T_base_tcp_init: Array,
    points_base: Array,
    vectors_m: Array,
    R_tcp_view_nominal: Array,
    settings: LineFitSettings | None = None,
) -> LineFit:
    """Where the tool-to-OOI vector vanishes in the viewing axes' x and y: orientation held, depth untouched.

    Model:   m_k = m_0 - a Rot(theta) A c_k + noise; c_k = (n, s)^T (p_k - p_init), A = [x y]-block of R_view_tcp for
             the nominal mount (it knows whether the plane is seen from behind); theta and m_0 by reweighted 2-D
             Kabsch, the scale a drawn to 1 by its prior; goal: a Rot(theta) A c = m_0.
    Args:    T_base_tcp_init: the circle's centre (4, 4); points_base: TCP at each sample (n, 3) [m]; vectors_m: OOI
             minus tool in the viewing axes (n, 2) [m], NaN where not seen: camera axes as the paper's tables, or the
             OOI's own axes where its orientation is known well; R_tcp_view_nominal: those axes in the TCP's (3, 3).
    Returns: the fit: OK, or TOO_FEW, DEGENERATE, POOR_FIT with the reason and no pose.
    Source:  Makinen et al. 2023, section 3.2.1 (the set-up); Kabsch 1976, Umeyama 1991 (in the plane).
    """
    limits = settings or LineFitSettings()
    T = require_pose(T_base_tcp_init, "T_base_tcp_init")
    A = _plane_to_view(require_rotation(R_tcp_view_nominal, "R_tcp_view_nominal"))
    points, vectors = _require_samples(points_base, vectors_m)
    usable = np.isfinite(vectors).all(axis=1)
    in_plane = (points - T[:3, 3]) @ T[:3, :2]
    samples = _SeenDrivenSamples(vectors[usable], in_plane[usable] @ A.T)
    few = _too_little(samples, limits)
    if few is not None:
        return _refused_fit(*few, len(points))
    fit = _robust_similarity(samples, limits.sigma_scale_frac)
    poor = _misfit_refusal(fit, limits)
    if poor is not None:
        return _refused_fit(*poor, len(points))
    covariance, sigma_turn = _goal_covariance(samples, fit, limits)
    goal_view = _rotated_plane_vectors(fit.translation_m[None], -fit.angle_rad)[0] / fit.scale
    A_inverse = np.linalg.inv(A)
    goal = A_inverse @ goal_view
    residuals, weights = np.full((len(points), 2), np.nan), np.zeros(len(points))
    residuals[usable], weights[usable] = fit.residuals, fit.weights
    return LineFit(
        status=CalibrationStatus.OK,
        reason="",
        T_base_tcp_ref=pose(T[:3, :3], T[:3, 3] + T[:3, :2] @ goal),
        covariance=A_inverse @ covariance @ A_inverse.T,
        turn_rad=-fit.angle_rad,  # a camera that turns one way sees everything turn the other way
        sigma_turn_rad=sigma_turn,
        scale=fit.scale,
        residuals_m=residuals,
        weights=weights,
        sigma_m=fit.sigma_m,
    )


def _plane_to_view(R_tcp_view: Array) -> Array:
    """A (2, 2): from coordinates along n, s to the viewing axes' x and y, for the nominal mount."""
    A = R_tcp_view.T[:2, :2]
    if np.linalg.svd(A, compute_uv=False)[-1] < 0.5:
        raise CalibrationInputError("viewing axes lie across the plane of motion; give the axes of an image of it")
    return A


def _require_samples(points_base: Array, vectors_m: Array) -> tuple[Array, Array]:
    points, vectors = np.asarray(points_base, dtype=float), np.asarray(vectors_m, dtype=float)
    if vectors.ndim != 2 or vectors.shape[1] != 2 or points.shape != (len(vectors), 3):
        raise CalibrationInputError(f"points {points.shape} must be (n, 3) and vectors {vectors.shape} (n, 2)")
    if not np.isfinite(points).all():
        raise CalibrationInputError("points_base must be finite; leave samples without a TCP pose out")
    return points, vectors


def _too_little(samples: _SeenDrivenSamples, limits: LineFitSettings) -> tuple[CalibrationStatus, str] | None:
    n = len(samples.seen_vectors_m)
    if n < limits.samples_min:
        text = f"OOI and tool seen together in {n} samples, at least {limits.samples_min} needed"
        return CalibrationStatus.TOO_FEW, f"{text}; keep both in view"
    centred = samples.driven_positions_m - samples.driven_positions_m.mean(axis=0)
    spread = float(np.linalg.svd(centred, compute_uv=False)[-1] / np.sqrt(n))
    if spread < limits.spread_min_m:
        text = (
            f"positions spread by {1e3 * spread:.0f} mm across their long axis, limit {1e3 * limits.spread_min_m:.0f}"
        )
        return CalibrationStatus.DEGENERATE, f"{text} mm; drive a wider circle"
    return None


def _robust_similarity(samples: _SeenDrivenSamples, sigma_scale: float) -> _Similarity:
    """Reweighted least squares; weights 1 / (1 + (|r| / 2 sigma)^2)^2 after a plain start."""
    weights = np.ones(len(samples.seen_vectors_m))
    sigma = np.inf
    fit = _weighted_fit(samples, weights, 1.0, sigma_scale)
    for _ in range(_ROUNDS):
        sizes = np.linalg.norm(fit.residuals, axis=1)
        sigma = max(float(np.median(sizes)) * _MAD_TO_SIGMA_2D, _SIGMA_FLOOR_M)
        weights = 1.0 / (1.0 + (sizes / (2.0 * sigma)) ** 2) ** 2
        fit = _weighted_fit(samples, weights, sigma, sigma_scale)
    return fit


def _weighted_fit(samples: _SeenDrivenSamples, weights: Array, sigma_m: float, sigma_scale: float) -> _Similarity:
    """2-D Kabsch in closed form, the scale drawn to 1."""
    share = weights / weights.sum()
    mean_seen, mean_driven = share @ samples.seen_vectors_m, share @ samples.driven_positions_m
    a, b = samples.seen_vectors_m - mean_seen, -(samples.driven_positions_m - mean_driven)
    along = float(weights @ np.sum(a * b, axis=1))
    across = float(weights @ (b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]))
    angle = float(np.arctan2(across, along))
    prior = sigma_m**2 / sigma_scale**2
    scale = (np.hypot(along, across) + prior) / (float(weights @ np.sum(b**2, axis=1)) + prior)
    m0 = mean_seen + scale * _rotated_plane_vectors(mean_driven[None], angle)[0]
    residuals = samples.seen_vectors_m - m0 + scale * _rotated_plane_vectors(samples.driven_positions_m, angle)
    return _Similarity(m0, angle, float(scale), weights, residuals, sigma_m)


def _rotated_plane_vectors(vectors: Array, angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return vectors @ np.array([[c, s], [-s, c]])


def _misfit_refusal(fit: _Similarity, limits: LineFitSettings) -> tuple[CalibrationStatus, str] | None:
    inliers = float(np.mean(np.linalg.norm(fit.residuals, axis=1) < 5.0 * fit.sigma_m))
    checks = (
        (1e3 * fit.sigma_m, 1e3 * limits.residual_max_m, "samples do not fit one motion: residual", "mm"),
        (1.0 - inliers, 1.0 - limits.inliers_min_frac, "too many samples disagree: share", ""),
        (
            np.rad2deg(abs(fit.angle_rad)),
            np.rad2deg(limits.from_nominal_max_rad),
            "camera turned from nominal by",
            "deg",
        ),
        (abs(fit.scale - 1.0), limits.scale_error_max_frac, "seen and driven lengths differ: share", ""),
    )
    for value, limit, text, unit in checks:
        if not value <= limit:
            reason = f"{text} {value:.2f}, limit {limit:.2f} {unit}".rstrip()
            return CalibrationStatus.POOR_FIT, f"{reason}; check marker sizes, mounting and clocks, then go round again"
    return None


def _goal_covariance(samples: _SeenDrivenSamples, fit: _Similarity, limits: LineFitSettings) -> tuple[Array, float]:
    """Covariance (2, 2) of the goal in nominal image axes [m^2], and one sigma of the angle [rad].

    Model:   normal equations of (m0, angle, scale) with the robust weights, carried to c = Rot(-angle) m0 / scale;
             plus the model's angle times the way, and a floor.
    """
    turned = _rotated_plane_vectors(samples.driven_positions_m, fit.angle_rad)
    J = np.zeros((len(turned), 2, 4))
    J[:, :, :2] = np.eye(2)
    J[:, :, 2] = -fit.scale * np.column_stack((-turned[:, 1], turned[:, 0]))
    J[:, :, 3] = -turned
    information = np.einsum("k,kia,kib->ab", fit.weights, J, J) / fit.sigma_m**2
    information[3, 3] += 1.0 / limits.sigma_scale_frac**2
    P = np.linalg.inv(information)
    goal = _rotated_plane_vectors(fit.translation_m[None], -fit.angle_rad)[0] / fit.scale
    normal = np.array([-goal[1], goal[0]])
    back = _rotated_plane_vectors(np.eye(2), -fit.angle_rad).T / fit.scale
    G = np.column_stack((back, -normal, -goal / fit.scale))
    model = limits.sigma_model_rad**2 * float(goal @ goal) + limits.sigma_floor_m**2
    return G @ P @ G.T + model * np.eye(2), float(np.sqrt(P[2, 2] + limits.sigma_model_rad**2))


def _refused_fit(status: CalibrationStatus, reason: str, n: int) -> LineFit:
    nan = float("nan")
    return LineFit(status, reason, None, None, nan, nan, nan, np.full((n, 2), nan), np.zeros(n), nan)


@dataclass(frozen=True, slots=True)
class TimedLineFit:
    """The line fit at the best clock offset: look time + `time_offset_s` = encoder time; 0 unless `offset_observable`.

    Not observable with an OK fit: no offset makes a difference. With a POOR_FIT: the best one lies beyond the search.
    """

    fit: LineFit
    time_offset_s: float
    offset_observable: bool


def fit_line_moving(
    T_base_tcp_init: Array,
    encoder: EncoderTrack,
    t_look_s: Array,
    vectors_m: Array,
    R_tcp_view_nominal: Array,
    settings: LineFitSettings | None = None,
    bound_s: float = 0.25,
    step_s: float = 0.025,
    contrast_min: float = 0.02,
) -> TimedLineFit:
    """The line fit over looks taken on the way, with the offset of the camera's clock.

    Model:   J(tau) = mean log(1 + |r(tau)|^2 / (2 sigma)^2) of the fit with the TCP at t + tau; grid, then a parabola.
             At even speed on a circle an offset looks like a turn; the rests between the points distinguish them.
    Args:    encoder: TCP over time; t_look_s: times of the looks (n,) [s]; vectors_m: (n, 2), as `fit_line`; bound_s,
             step_s: search range and grid; contrast_min: smallest relative rise of J at +-0.1 s.
    Returns: the fit at the best offset, or at 0 when J is flat or no offset gives a fit. POOR_FIT without a pose when
             J falls to the end of the search, which reaches one step beyond bound_s.
    """
    require_track(encoder.t_s, encoder.Ts_base_tcp, "encoder track")
    t, vectors = np.asarray(t_look_s, dtype=float), np.asarray(vectors_m, dtype=float)
    if t.ndim != 1 or vectors.shape != (len(t), 2) or not np.isfinite(t).all():
        raise CalibrationInputError(f"look times {t.shape} must be finite (n,), vectors {vectors.shape} (n, 2)")

    def fit_at(tau_s: float) -> LineFit:
        points, inside = positions_at(t + tau_s, encoder.t_s, encoder.Ts_base_tcp[:, :3, 3])
        seen = np.where(inside[:, None], vectors, np.nan)
        return fit_line(T_base_tcp_init, points, seen, R_tcp_view_nominal, settings)

    reach = round(bound_s / step_s) + 1
    grid = step_s * np.arange(-reach, reach + 1, dtype=np.float64)
    offset = _best_offset(grid, [fit_at(float(tau)) for tau in grid], contrast_min)
    if offset is None:
        return TimedLineFit(fit_at(0.0), 0.0, offset_observable=False)
    if abs(offset) > bound_s + 0.5 * step_s:
        return TimedLineFit(_refuse_clock_offset(fit_at(offset), bound_s), 0.0, offset_observable=False)
    return TimedLineFit(fit_at(offset), offset, offset_observable=True)


def _refuse_clock_offset(fit: LineFit, bound_s: float) -> LineFit:
    reason = f"clock offset of camera and encoders is beyond +-{bound_s:g} s; check the clocks, then go round again"
    return replace(fit, status=CalibrationStatus.POOR_FIT, reason=reason, T_base_tcp_ref=None, covariance=None)


def _best_offset(grid: Array, fits: list[LineFit], contrast_min: float) -> float | None:
    """Offset [s] at the minimum of J, the grid's end where J falls to it, or None when J is flat."""
    ok = np.array([fit.status is CalibrationStatus.OK for fit in fits])
    if ok.sum() < 3:
        return None
    sigma = max(min(fit.sigma_m for fit, good in zip(fits, ok, strict=True) if good), 1e-5)
    cost = np.array([_robust_fit_cost(fit, sigma) for fit in fits])
    best = int(np.argmin(cost))
    reach = max(1, round(0.1 / float(grid[1] - grid[0])))
    sides = [cost[i] for i in (best - reach, best + reach) if 0 <= i < len(grid)]
    if min(sides) / cost[best] - 1.0 < contrast_min:
        return None
    if best in (0, len(grid) - 1):
        return float(grid[best])
    before, here, after = cost[best - 1 : best + 2]
    if not np.isfinite([before, after]).all():
        return float(grid[best])
    return float(grid[best] + 0.5 * (before - after) / (before - 2.0 * here + after) * (grid[1] - grid[0]))


def _robust_fit_cost(fit: LineFit, sigma_m: float) -> float:
    if fit.status is not CalibrationStatus.OK:
        return np.inf
    sizes = np.linalg.norm(fit.residuals_m, axis=1)
    return float(np.mean(np.log1p((sizes[np.isfinite(sizes)] / (2.0 * sigma_m)) ** 2)))
