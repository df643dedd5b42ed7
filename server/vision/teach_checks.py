"""When a layout must not be believed: views too few or too alike, markers never together, contradictions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array
from server.vision.teach_contracts import TeachSettings, TeachStatus, TeachView
from server.vision.teach_fit import UNKNOWNS_PER_MARKER, Corners, LayoutFit, LayoutState, Priors, fit_layout
from server.vision.teach_start import SeenViews, groups_seen_together

STRAY_RMS_FACTOR = 6.0
SUSPICIOUS_RESIDUAL_SIGMAS = 2.0  # residual in units of the corners' noise above which a reason is looked for
RESIDUAL_DROP_FACTOR_MIN = 2.0  # by which the residual must fall without a marker to blame it
TIME_SPLITS_MAX = 7
STRAY_SIGHTINGS_MAX_FRAC = 0.25  # of a marker's sightings, above which it is the marker and not the picture
SIDE_ERROR_MAX_SIGMAS = 3.5


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why there is no layout."""

    status: TeachStatus
    reason: str


def check_input(views: Sequence[TeachView], wanted: Sequence[int]) -> Refusal | None:
    """Refuse repeated ids and a wanted marker that no view shows."""
    for number, view in enumerate(views, 1):
        repeated = sorted(view.repeated_ids & set(wanted))
        if repeated:
            return Refusal(
                TeachStatus.CONTRADICTION,
                f"marker id {repeated[0]} is seen at two places in view {number}; cover or remove one of the two",
            )
    missing = [
        marker_id
        for marker_id in wanted
        if not any(marker_id in view.left_corners_px or marker_id in view.right_corners_px for view in views)
    ]
    if missing:
        return Refusal(
            TeachStatus.NO_MARKERS,
            f"marker {_comma_separated(missing)} is in no view; bring it into view, or leave it out of --ids",
        )
    return None


def check_connected(seen: SeenViews) -> Refusal | None:
    """Refuse markers that no chain of views joins."""
    groups = groups_seen_together(seen)
    if len(groups) == 1:
        return None
    names = " and ".join(f"{{{_comma_separated([seen.marker_ids[k] for k in group])}}}" for group in groups)
    return Refusal(
        TeachStatus.NOT_CONNECTED,
        f"markers {names} are never seen together; take views that show markers of both groups together",
    )


def camera_places(Ts_cam_ref: Array) -> Array:
    """The left camera (v, 3) [m] in the reference marker's axes."""
    return -np.einsum("vji,vj->vi", Ts_cam_ref[:, :3, :3], Ts_cam_ref[:, :3, 3])


def view_directions_and_distances(state: LayoutState) -> tuple[Array, Array]:
    """Unit vectors (v, 3) from the layout's middle to the camera, and distances (v,) [m]."""
    away = camera_places(state.Ts_cam_ref) - state.Ts_ref_marker[:, :3, 3].mean(axis=0)
    distance = np.linalg.norm(away, axis=1)
    return away / distance[:, None], distance


def spread_deg(state: LayoutState) -> float:
    """Angle between the two outermost viewing directions [deg]."""
    towards, _ = view_directions_and_distances(state)
    return float(np.rad2deg(np.arccos(np.clip(towards @ towards.T, -1.0, 1.0)).max()))


def n_distinct(state: LayoutState, settings: TeachSettings) -> int:
    """How many views differ from each other in direction or distance."""
    towards, distance = view_directions_and_distances(state)
    kept: list[int] = []
    for v in range(len(towards)):
        alike = [
            np.rad2deg(np.arccos(np.clip(towards[v] @ towards[k], -1.0, 1.0))) < settings.view_apart_deg
            and abs(distance[v] / distance[k] - 1.0) < settings.view_apart_frac
            for k in kept
        ]
        if not any(alike):
            kept.append(v)
    return len(kept)


def check_directions(state: LayoutState, settings: TeachSettings) -> Refusal | None:
    """Refuse views that are too few or too alike to separate the layout from the lens."""
    how = "move the camera sideways and up or down by a third of its distance, all markers in view, and take more views"
    distinct, spread = n_distinct(state, settings), spread_deg(state)
    if distinct < settings.views_min:
        status = TeachStatus.TOO_ALIKE if len(state.Ts_cam_ref) >= settings.views_min else TeachStatus.TOO_FEW_VIEWS
        return Refusal(status, f"{distinct} views differ from each other (limit {settings.views_min}); {how}")
    if spread < settings.spread_min_deg:
        return Refusal(
            TeachStatus.TOO_ALIKE,
            f"the views lie within {spread:.1f} deg of each other (limit {settings.spread_min_deg:g} deg); {how}",
        )
    return None


def sighting_rms_px(fit: LayoutFit, corners: Corners, n_views: int, n_markers: int) -> Array:
    """Rms per coordinate (v, m) [px] of every marker in every view; NaN where it was not seen."""
    n = n_views * n_markers
    squares = (fit.residuals_px**2).mean(axis=1)
    total = np.bincount(corners.sighting_indices, weights=squares, minlength=n)
    count = np.bincount(corners.sighting_indices, minlength=n)
    mean = np.divide(total, count, out=np.full(n, np.nan), where=count > 0)
    return np.sqrt(mean).reshape(n_views, n_markers)


def stray_sightings(rms_px: Array, settings: TeachSettings) -> NDArray[np.bool_]:
    """Single sightings (v, m) that do not fit the others; a marker with many of them is left to `check_rigid`."""
    bad = rms_px > max(settings.sighting_max_px, STRAY_RMS_FACTOR * float(np.nanmedian(rms_px)))
    share = bad.sum(axis=0) / np.maximum(np.isfinite(rms_px).sum(axis=0), 1)
    return bad & (share <= STRAY_SIGHTINGS_MAX_FRAC)


def check_rigid(
    fit: LayoutFit, corners: Corners, priors: Priors, ids: Sequence[int], settings: TeachSettings
) -> Refusal | None:
    """Refuse a layout that is not rigid, and name the marker that moved.

    A marker is blamed where the others by themselves fit far better than all together; of two markers, where the views
    before some moment and those after it do.
    """
    whole, again = rms_of(fit.residuals_px), "and take all views again"
    if whole <= SUSPICIOUS_RESIDUAL_SIGMAS * settings.sigma_px:
        return None
    if len(ids) == 2:
        apart = _split_rms_px(fit, corners, priors)
        if apart * RESIDUAL_DROP_FACTOR_MIN < whole:
            return Refusal(
                TeachStatus.CONTRADICTION,
                f"markers {_comma_separated(ids)} moved against each other "
                f"({whole:.2f} px rms, {apart:.2f} px before and after it); fasten both {again}",
            )
    else:
        blamed, without = _worst_fitting_marker(fit, corners, priors, ids)
        if without * RESIDUAL_DROP_FACTOR_MIN < whole:
            return Refusal(
                TeachStatus.CONTRADICTION,
                f"marker {ids[blamed]} moved between the views, or is not flat: {whole:.2f} px rms with it, "
                f"{without:.2f} px without it; fasten it {again}, or leave it out of --ids",
            )
    if whole <= settings.residual_max_px:
        return None
    return Refusal(
        TeachStatus.CONTRADICTION,
        f"no rigid layout explains the views: {whole:.2f} px rms (limit {settings.residual_max_px:g} px); check the "
        f"camera file, make sure that camera and markers stand still, {again}",
    )


def _worst_fitting_marker(fit: LayoutFit, corners: Corners, priors: Priors, ids: Sequence[int]) -> tuple[int, float]:
    """The marker without which the others fit best, and their rms [px]."""
    trials = []
    for k in range(len(ids)):
        rest = corners.without_rows(corners.marker_indices == k)
        if len(rest.view_indices):
            trials.append((rms_of(fit_layout(fit.state, rest, priors).residuals_px), k))
    rms, k = min(trials)
    return k, rms


def _split_rms_px(fit: LayoutFit, corners: Corners, priors: Priors) -> float:
    """Rms [px] of the views before and after some moment, fitted apart; the least over some moments."""
    n_views, found = len(fit.state.Ts_cam_ref), [rms_of(fit.residuals_px)]
    for moment in np.unique(np.linspace(2, n_views - 2, TIME_SPLITS_MAX).round()):
        late = corners.view_indices >= moment
        parts = [fit_layout(fit.state, corners.without_rows(drop), priors).residuals_px for drop in (late, ~late)]
        found.append(rms_of(np.concatenate(parts)))
    return min(found)


def check_sides(
    free: LayoutFit, printed_m: Mapping[int, float], ids: Sequence[int], settings: TeachSettings
) -> Refusal | None:
    """Refuse printed sides that the stereo baseline contradicts: one by itself, or all by one factor.

    `free`: the fit that knows the baseline and no side.
    """
    rows = [k for k, marker_id in enumerate(ids) if marker_id in printed_m]
    if not rows:
        return None
    printed = np.array([printed_m[ids[k]] for k in rows])
    ratio = free.state.sides_m[rows] / printed
    variance = np.diag(free.covariance)[[UNKNOWNS_PER_MARKER * k + 6 for k in rows]] + settings.side_sigma_m**2
    sigma = np.sqrt(variance) / printed
    common = float(np.median(ratio))
    against = np.sqrt(1.0 + 1.5 / len(rows))  # the median of the others has its own error
    limit = np.maximum(settings.side_error_max_frac, SIDE_ERROR_MAX_SIGMAS * against * sigma)
    worst = int(np.argmax(np.abs(ratio - common) / limit))
    if abs(ratio[worst] - common) > limit[worst]:
        return _one_wrong(ids[rows[worst]], float(printed[worst]), float(ratio[worst]), common, float(sigma[worst]))
    sigma_all = float(np.hypot(sigma.min(), settings.baseline_sigma_frac))
    limit_all = max(settings.side_error_max_frac, SIDE_ERROR_MAX_SIGMAS * sigma_all)
    if abs(common - 1.0) <= limit_all:
        return None
    return Refusal(
        TeachStatus.CONTRADICTION,
        f"the printed sides look {100 * (common - 1):+.2f} % off (limit {100 * limit_all:.2g} %): either the print is "
        "scaled (check its 100 mm ruler) or baseline_m of the camera file is wrong; correct one of them",
    )


def _one_wrong(marker_id: int, printed_m: float, ratio: float, common: float, sigma: float) -> Refusal:
    return Refusal(
        TeachStatus.CONTRADICTION,
        f"marker {marker_id}: side_m = {printed_m:.5g} m, but the images say {printed_m * ratio:.5g} +- "
        f"{printed_m * sigma:.1g} m ({100 * (ratio / common - 1):+.2f} % against the others); measure its black outer "
        "side again, or leave its side to the images",
    )


def check_sigmas(worst_position_m: float, worst_angle_deg: float, settings: TeachSettings) -> Refusal | None:
    """Refuse a layout that is not known well enough."""
    if worst_position_m <= settings.position_sigma_max_m and worst_angle_deg <= settings.angle_sigma_max_deg:
        return None
    return Refusal(
        TeachStatus.NOT_DETERMINED,
        f"the layout is known to {1e3 * worst_position_m:.2f} mm and {worst_angle_deg:.2f} deg only (limits "
        f"{1e3 * settings.position_sigma_max_m:g} mm, {settings.angle_sigma_max_deg:g} deg); come closer, and take "
        "more views from other directions",
    )


def rms_of(residuals_px: Array) -> float:
    """Root mean square per coordinate [px]."""
    return float(np.sqrt(np.mean(residuals_px**2)))


def _comma_separated(ids: Sequence[int]) -> str:
    return ", ".join(str(number) for number in ids)
