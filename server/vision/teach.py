"""A marker layout measured from stereo views: all markers and all views in one least-squares problem, or why not.

views -> checks of the input -> start -> joint fit -> views differ? rigid? sides right? -> frame -> layout
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machine.description import StereoCamera
from machine.markers import CORNER_SIGNS
from machine.poses import inverse_pose, pose, pose_difference, transform_points
from machine.rotations import nearest_rotation
from server.vision.contracts import Array
from server.vision.object_pose import fitted_variance
from server.vision.teach_checks import (
    Refusal,
    check_connected,
    check_directions,
    check_input,
    check_rigid,
    check_sides,
    check_sigmas,
    rms_of,
    sighting_rms_px,
    spread_deg,
    stray_sightings,
)
from server.vision.teach_contracts import (
    TaughtLayout,
    TaughtMarker,
    TeachSettings,
    TeachStatus,
    TeachView,
    angle_sigma_rad,
    position_sigma_m,
)
from server.vision.teach_fit import (
    UNKNOWNS_PER_MARKER,
    Corners,
    LayoutFit,
    LayoutState,
    Priors,
    fit_layout,
    stepped_state,
)
from server.vision.teach_start import SeenViews, corners_of, first_sides, start_of

FrameName = Literal["present", "reference", "middle"]
DERIVATIVE_STEP = 1e-6  # of a numeric derivative, rad and m
COLLINEAR_SPREAD_MAX_FRAC = 0.2  # of the widest extent: centres that spread less across lie on a line


@dataclass(frozen=True, slots=True)
class LayoutFrame:
    """Where the object's origin shall lie.

    "present": where the present layout fits the new one best. "reference": the reference marker keeps its present pose
    (identity where it has none). "middle": the mean of the markers' centres, z square to their plane, x along the
    reference marker's x axis. `present_markers`: T_on_marker and side [m] by id.
    """

    name: FrameName
    present_markers: Mapping[int, tuple[Array, float]]


def place_layout(state: LayoutState, ids: Sequence[int], frame: LayoutFrame) -> Array:
    """T_on_marker (m, 4, 4) in the wanted frame."""
    if frame.name == "middle":
        T_on_ref = _from_middle(state)
    elif frame.name == "present" and any(marker_id in frame.present_markers for marker_id in ids):
        T_on_ref = _best_fit(state, ids, frame.present_markers)
    else:
        T_on_ref = frame.present_markers.get(ids[0], (np.eye(4), 0.0))[0]
    return T_on_ref @ state.Ts_ref_marker


def placed_covariances(state: LayoutState, covariance: Array, ids: Sequence[int], frame: LayoutFrame) -> Array:
    """Covariances (m, 6, 6) of T_on_marker in the wanted frame, by central differences through the frame's choice.

    Args: covariance (7 m + 1, 7 m + 1) of markers (T_ref_marker by left perturbation, side) and baseline.
    """
    rows = np.flatnonzero(np.diag(covariance) > 0.0)
    J = np.zeros((len(ids), 6, len(rows)))
    for column, row in enumerate(rows):
        step = np.zeros(len(covariance))
        step[row] = DERIVATIVE_STEP
        plus = place_layout(stepped_state(state, step), ids, frame)
        minus = place_layout(stepped_state(state, -step), ids, frame)
        for k in range(len(ids)):
            J[k, :, column] = pose_difference(minus[k], plus[k]) / (2.0 * DERIVATIVE_STEP)
    found = J @ covariance[np.ix_(rows, rows)] @ J.transpose(0, 2, 1)
    return 0.5 * (found + found.transpose(0, 2, 1))


def _best_fit(state: LayoutState, ids: Sequence[int], present: Mapping[int, tuple[Array, float]]) -> Array:
    """T_on_ref that lays the new corners onto the present ones (Kabsch 1976)."""
    new, old = [], []
    for k, marker_id in enumerate(ids):
        if marker_id in present:
            T_on_marker, side_m = present[marker_id]
            new.append(transform_points(state.Ts_ref_marker[k], 0.5 * state.sides_m[k] * CORNER_SIGNS))
            old.append(transform_points(T_on_marker, 0.5 * side_m * CORNER_SIGNS))
    source, target = np.concatenate(new), np.concatenate(old)
    middle, aim = source.mean(axis=0), target.mean(axis=0)
    rotation = nearest_rotation((target - aim).T @ (source - middle))
    return pose(rotation, aim - rotation @ middle)


def _from_middle(state: LayoutState) -> Array:
    centres = state.Ts_ref_marker[:, :3, 3]
    middle = centres.mean(axis=0)
    z = state.Ts_ref_marker[:, :3, 2].mean(axis=0)
    _, extents, axes = np.linalg.svd(centres - middle, full_matrices=False)
    if len(centres) >= 3 and extents[1] > COLLINEAR_SPREAD_MAX_FRAC * extents[0]:
        z = axes[2] * np.sign(axes[2] @ z)
    z = z / np.linalg.norm(z)
    x = state.Ts_ref_marker[0, :3, 0]
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return inverse_pose(pose(np.column_stack([x, np.cross(z, x), z]), middle))


FIXED_BASELINE_SIGMA_FRAC = 1e-9  # in the fit that asks the images for the sides


@dataclass(frozen=True, slots=True)
class TeachTask:
    """What is to be taught: ids (the first is the reference), printed sides [m] as far as known, and the frame."""

    marker_ids: tuple[int, ...]
    printed_m: Mapping[int, float]
    layout_frame: LayoutFrame


@dataclass(frozen=True, slots=True)
class _LayoutFitPair:
    """Both fits of one set of corners: with all that is known, and with the sides left to the images."""

    seen_views: SeenViews
    corners: Corners
    known_sides_fit: LayoutFit
    free_sides_fit: LayoutFit
    n_dropped: int


def teach_layout(
    views: Sequence[TeachView], task: TeachTask, camera: StereoCamera, settings: TeachSettings
) -> TaughtLayout:
    """The layout of markers on one rigid object, from stereo pairs at rest.

    Model:   see `fit_layout`; printed sides and the baseline enter with their own sigmas. The covariance takes the
             corners' noise from the residuals where they are larger than assumed.
    Args:    views: stereo pairs from different directions, raw px. camera: both eyes.
    Returns: TaughtLayout; markers only where the status is OK.
    """
    fits = _fit_layouts(views, task, camera, settings)
    if isinstance(fits, Refusal):
        return layout_not_found(fits, len(views))
    refusal = check_sides(fits.free_sides_fit, task.printed_m, task.marker_ids, settings)
    markers = _taught_markers(fits, task)
    refusal = refusal or check_sigmas(
        max(position_sigma_m(marker) for marker in markers),
        float(np.rad2deg(max(angle_sigma_rad(marker) for marker in markers))),
        settings,
    )
    last = UNKNOWNS_PER_MARKER * len(task.marker_ids)
    layout = TaughtLayout(
        status=TeachStatus.OK,
        reason="",
        markers=markers,
        n_views=len(fits.seen_views.views),
        spread_deg=spread_deg(fits.known_sides_fit.state),
        residual_rms_px=rms_of(fits.known_sides_fit.residuals_px),
        baseline_frac=fits.known_sides_fit.state.baseline_frac,
        baseline_sigma_frac=float(np.sqrt(fits.known_sides_fit.covariance[last, last])),
        notes=(f"{fits.n_dropped} sightings did not fit the others and were left out",) if fits.n_dropped else (),
    )
    return layout if refusal is None else replace(layout, status=refusal.status, reason=refusal.reason, markers=())


def layout_not_found(refusal: Refusal, n_views: int) -> TaughtLayout:
    """A layout that there is not."""
    nan = float("nan")
    return TaughtLayout(refusal.status, refusal.reason, (), n_views, nan, nan, nan, nan)


def _fit_layouts(
    views: Sequence[TeachView], task: TeachTask, camera: StereoCamera, settings: TeachSettings
) -> _LayoutFitPair | Refusal:
    refusal = _check_task(task) or check_input(views, task.marker_ids)
    if refusal:
        return refusal
    seen = SeenViews(
        task.marker_ids, tuple(view for view in views if len(_visible_marker_ids(view, task.marker_ids)) > 1)
    )
    refusal = check_connected(seen)
    if refusal:
        return refusal
    sides = first_sides(seen, task.printed_m, camera)
    if not np.isfinite(sides).all():
        unknown = task.marker_ids[int(np.argmin(np.isfinite(sides)))]
        reason = (
            f"marker {unknown} has no printed side and is never seen by both eyes; give its side, or show it to both"
        )
        return Refusal(TeachStatus.NOT_DETERMINED, reason)
    start = start_of(seen, sides, camera)
    if start is None:
        return Refusal(
            TeachStatus.CONTRADICTION, "no pose puts the markers in front of the camera; check the camera file"
        )
    corners = corners_of(seen, camera)
    priors = _layout_priors(task, sides, settings)
    fit = fit_layout(start, corners, priors)
    stray = stray_sightings(sighting_rms_px(fit, corners, len(seen.views), len(task.marker_ids)), settings)
    if stray.any():
        corners = corners.without_rows(stray.ravel()[corners.sighting_indices])
        fit = fit_layout(fit.state, corners, priors)
    refusal = check_directions(fit.state, settings) or check_rigid(fit, corners, priors, task.marker_ids, settings)
    return refusal or _refit_with_measured_noise(seen, corners, fit, priors, int(stray.sum()))


def _check_task(task: TeachTask) -> Refusal | None:
    if len(set(task.marker_ids)) == len(task.marker_ids) > 1:
        return None
    return Refusal(
        TeachStatus.NO_MARKERS,
        f"{len(set(task.marker_ids))} different markers to teach; a layout needs two or more, each with an id of its "
        "own",
    )


def _visible_marker_ids(view: TeachView, ids: Sequence[int]) -> list[int]:
    return [marker_id for marker_id in ids if marker_id in view.left_corners_px or marker_id in view.right_corners_px]


def _layout_priors(task: TeachTask, sides_m: Array, settings: TeachSettings) -> Priors:
    sigmas = [settings.side_sigma_m if marker_id in task.printed_m else np.inf for marker_id in task.marker_ids]
    return Priors(sides_m, np.array(sigmas), settings.baseline_sigma_frac, settings.sigma_px)


def _refit_with_measured_noise(
    seen: SeenViews, corners: Corners, fit: LayoutFit, priors: Priors, n_dropped: int
) -> _LayoutFitPair:
    """Take the noise from the residuals, and ask the images for the sides."""
    dof = fit.residuals_px.size - 6 * len(seen.views) - UNKNOWNS_PER_MARKER * len(seen.marker_ids) + 6
    variance = fitted_variance(float((fit.residuals_px**2).sum()), dof, priors.sigma_px)
    noisy = replace(priors, sigma_px=float(np.sqrt(variance)))
    known = fit_layout(fit.state, corners, noisy)
    only_images = replace(
        noisy, side_sigmas_m=np.full(len(seen.marker_ids), np.inf), baseline_sigma_frac=FIXED_BASELINE_SIGMA_FRAC
    )
    free = fit_layout(replace(known.state, baseline_frac=0.0), corners, only_images)
    return _LayoutFitPair(seen, corners, known, free, n_dropped)


def _taught_markers(fits: _LayoutFitPair, task: TeachTask) -> tuple[TaughtMarker, ...]:
    state, ids = fits.known_sides_fit.state, task.marker_ids
    Ts = place_layout(state, ids, task.layout_frame)
    covariances = placed_covariances(state, fits.known_sides_fit.covariance, ids, task.layout_frame)
    n = len(ids)
    rms = sighting_rms_px(fits.known_sides_fit, fits.corners, len(fits.seen_views.views), n)
    side_sigmas, free_sigmas = (
        np.sqrt(np.diag(fit.covariance)[6 : UNKNOWNS_PER_MARKER * n : UNKNOWNS_PER_MARKER])
        for fit in (fits.known_sides_fit, fits.free_sides_fit)
    )
    return tuple(
        TaughtMarker(
            marker_id=marker_id,
            side_m=float(state.sides_m[k]),
            side_sigma_m=float(side_sigmas[k]),
            printed_side_m=task.printed_m.get(marker_id),
            stereo_side_m=float(fits.free_sides_fit.state.sides_m[k]),
            stereo_side_sigma_m=float(free_sigmas[k]),
            T_on_marker=Ts[k],
            covariance=covariances[k],
            n_views=int(np.isfinite(rms[:, k]).sum()),
            residual_rms_px=float(np.sqrt(np.nanmean(rms[:, k] ** 2))),
        )
        for k, marker_id in enumerate(ids)
    )
