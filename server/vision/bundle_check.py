"""Whether the numbers of a bundle problem can be adjusted at all; shapes are checked in `bundle_layout`."""

import numpy as np

from server.vision.bundle_contracts import BundleProblem
from server.vision.bundle_layout import BundleLayout, BundleState
from server.vision.contracts import Array

ROTATION_TOL = 1e-6
SYMMETRY_TOL = 1e-9
SIZE_MAX = 1e9  # m, px or rays: beyond, squares lose their digits


def why_degenerate(problem: BundleProblem, layout: BundleLayout, start: BundleState) -> str:
    """A reason why nothing can be adjusted, or an empty string."""
    if len(problem.Ts_vo_cam) == 0 or len(problem.frames) == 0:
        return f"{len(problem.Ts_vo_cam)} frames and {len(problem.frames)} observations; there is nothing to adjust"
    return _bad_numbers(problem, layout, start) or _bad_priors(layout) or _bad_structure(problem, layout)


def _bad_numbers(problem: BundleProblem, layout: BundleLayout, start: BundleState) -> str:
    if not _sane(start.rotation) or not _sane(start.position):
        return "a start pose is not finite"
    off = np.abs(start.rotation @ start.rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    if (off > ROTATION_TOL).any() or (np.linalg.det(start.rotation) < 0.0).any():
        return f"start pose {int(off.argmax())} is not a rotation (off by {off.max():.1e})"
    observed = np.diff(layout.first) > 0
    if not _sane(start.points[observed]) or not _sane(layout.in_body):
        return "the place of an observed point is not finite"
    if not _sane(layout.rays):
        return "a ray is infinite"
    measured = ~np.isnan(problem.uv[:, 0]), ~np.isnan(problem.uv[:, 2])
    for eye in range(2):
        sigma = problem.sigma_px[measured[eye], min(eye, problem.uv.shape[1] - 3)]
        if not ((sigma > 0.0) & (sigma < SIZE_MAX)).all():
            return "a sigma is not a positive number"
    if not (min(problem.focal_px) > 0.0 and np.isfinite(problem.baseline_m) and problem.baseline_m > 0.0):
        return f"focal lengths {problem.focal_px} px and baseline {problem.baseline_m} m have to be positive"
    return "" if _sane(layout.scale) else "a sigma is too small for its focal length"


def _sane(array: Array) -> bool:
    return bool((np.abs(array) < SIZE_MAX).all())


def _bad_priors(layout: BundleLayout) -> str:
    for body in np.flatnonzero(layout.has_prior):
        own = layout.information[body]
        if not np.isfinite(own).all():
            return f"the information on body {body} is not finite"
        size = np.abs(own).max()
        if np.abs(own - own.T).max() > SYMMETRY_TOL * size or np.linalg.eigvalsh(own).min() < -SYMMETRY_TOL * size:
            return f"the information on body {body} is not symmetric and positive"
    return ""


def _bad_structure(problem: BundleProblem, layout: BundleLayout) -> str:
    held = (layout.column < 0).any() or layout.has_prior.any()
    if not held and not (problem.fixed_points is not None and problem.fixed_points.any()):
        return "no frame, group or point is fixed and no prior is given: everything could move together"
    bodies = len(layout.column)
    seen = np.zeros(bodies, dtype=bool)
    seen[layout.frame[layout.alive]] = True
    body = np.repeat(layout.body, np.diff(layout.first))[layout.alive]
    seen[body[body >= 0]] = True
    lonely = np.flatnonzero(~seen & (layout.column >= 0) & ~layout.has_prior)
    if len(lonely):
        return f"{_named(int(lonely[0]), len(problem.Ts_vo_cam))} has no observation and no prior"
    return ""


def _named(body: int, n_frames: int) -> str:
    return f"frame {body}" if body < n_frames else f"group {body - n_frames}"
