"""Looks taken while moving: the clock offset found with the line fit, so that the circle needs no stops."""

from dataclasses import dataclass, replace

import numpy as np

from server.calibration.checks import CalibrationInputError, require_track
from server.calibration.contracts import Array, CalibrationStatus, EncoderTrack
from server.calibration.line_equation_fit import LineFit, LineFitSettings, fit_line
from server.calibration.time_offset import positions_at


@dataclass(frozen=True, slots=True)
class TimedLineFit:
    """The line fit at the best clock offset: look time + `time_offset_s` = encoder time; 0 when not `observable`.

    Not observable with an OK fit: no offset makes a difference. With a POOR_FIT: the best one lies beyond the search.
    """

    fit: LineFit
    time_offset_s: float
    observable: bool


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
    Raises:  CalibrationInputError: shapes, times that are not finite.
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
        return TimedLineFit(fit_at(0.0), 0.0, observable=False)
    if abs(offset) > bound_s + 0.5 * step_s:
        return TimedLineFit(_beyond(fit_at(offset), bound_s), 0.0, observable=False)
    return TimedLineFit(fit_at(offset), offset, observable=True)


def _beyond(fit: LineFit, bound_s: float) -> LineFit:
    reason = f"clock offset of camera and encoders is beyond +-{bound_s:g} s; check the clocks, then go round again"
    return replace(fit, status=CalibrationStatus.POOR_FIT, reason=reason, T_base_tcp_ref=None, covariance=None)


def _best_offset(grid: Array, fits: list[LineFit], contrast_min: float) -> float | None:
    """Offset [s] at the minimum of J, the grid's end where J falls to it, or None when J is flat."""
    ok = np.array([fit.status is CalibrationStatus.OK for fit in fits])
    if ok.sum() < 3:
        return None
    sigma = max(min(fit.sigma_m for fit, good in zip(fits, ok, strict=True) if good), 1e-5)
    cost = np.array([_cost(fit, sigma) for fit in fits])
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


def _cost(fit: LineFit, sigma_m: float) -> float:
    if fit.status is not CalibrationStatus.OK:
        return np.inf
    sizes = np.linalg.norm(fit.residuals_m, axis=1)
    return float(np.mean(np.log1p((sizes[np.isfinite(sizes)] / (2.0 * sigma_m)) ** 2)))
