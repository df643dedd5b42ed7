"""Whether an adjusted bundle is believed."""

import numpy as np

from server.vision.bundle_contracts import BundleSettings, Indices
from server.vision.bundle_covariance import Fit, Spread
from server.vision.bundle_layout import BundleLayout, BundleWork
from server.vision.contracts import Array

OWN_MIN = 1e-10  # share of an unknown's information that must be its own; rounding leaves about 1e-14 of a gauge


def why_not_believed(
    layout: BundleLayout,
    work: BundleWork,
    spread: Spread,
    fit: Fit,
    seen: Indices,
    n_frames: int,
    settings: BundleSettings,
) -> str:
    """A reason why the optimum says nothing about the poses, or an empty string."""
    if fit.redundancy <= 0:
        return f"{-fit.redundancy} measurements too few for the unknowns"
    if not np.isfinite(spread.covariance).all() or (spread.own_frac < OWN_MIN).any():
        weakest = int(spread.own_frac.argmin()) // 6
        return f"{_name(layout, weakest, n_frames)} is not determined by its observations"
    wanted = np.bincount(layout.frame, (seen > 0).sum(axis=1), minlength=n_frames)
    agreed = np.bincount(layout.frame, fit.agree.sum(axis=1), minlength=n_frames)
    share = np.where(wanted > 0, agreed / np.maximum(wanted, 1), 1.0)
    share[layout.column[:n_frames] < 0] = 1.0
    worst = int(share.argmin())
    if share[worst] < settings.inliers_min_frac:
        return f"frame {worst}: {agreed[worst]:.0f} of {wanted[worst]:.0f} rays agree with the rest"
    return _too_wide(layout, work, spread, fit, n_frames, settings)


def _too_wide(
    layout: BundleLayout, work: BundleWork, spread: Spread, fit: Fit, n_frames: int, settings: BundleSettings
) -> str:
    sigmas = np.sqrt(fit.variance_factor * np.diag(spread.covariance)).reshape(-1, 2, 3).max(axis=2)
    depths = _median_depths(layout, work)
    for body in np.flatnonzero(layout.column >= 0):
        rotation, position = sigmas[layout.column[body]]
        name = _name(layout, int(layout.column[body]), n_frames)
        if rotation > settings.sigma_rotation_max_rad:
            return f"{name}: sigma of the rotation {np.rad2deg(rotation):.1f} deg; too little is seen"
        if position > settings.sigma_position_max_frac * depths[body]:
            return f"{name}: sigma of the position {position:.3g} m at {depths[body]:.3g} m from the points"
    return ""


def _median_depths(layout: BundleLayout, work: BundleWork) -> Array:
    """Median distance of each body's points from their eyes (b,); of a body that nothing sees: infinite."""
    depths = np.full(len(layout.column), np.inf)
    distance = np.linalg.norm(work.arm, axis=1)
    body = np.repeat(layout.body, np.diff(layout.first))
    for number in range(len(depths)):
        own = ((layout.frame == number) | (body == number)) & layout.alive
        if own.any():
            depths[number] = np.median(distance[own])
    return depths


def _name(layout: BundleLayout, column: int, n_frames: int) -> str:
    body = int(np.flatnonzero(layout.column == column)[0])
    return f"frame {body}" if body < n_frames else f"group {body - n_frames}"
