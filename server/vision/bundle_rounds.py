"""Adjusting in rounds: roughly with everything, then without the outliers and with the noise that there is."""

from typing import NamedTuple

import numpy as np

from server.vision.bundle_contracts import BundleLoss, BundleSettings, Indices
from server.vision.bundle_covariance import noise_of, seen_counts
from server.vision.bundle_layout import BundleLayout, BundleState, BundleWork
from server.vision.bundle_levenberg import NOT_FINITE, minimise, total_cost
from server.vision.bundle_residuals import HUBER, drop_behind, linearise
from server.vision.contracts import Array

ROUNDS_MAX = 4
ROUGH_STEP_SIGMA = 0.5  # per unknown: near enough to tell outliers; the slow end of reweighting is saved
ROUGH_FRAC = 0.5  # of the iterations
STEADY_FRAC = 0.1  # a noise that changed by less needs no further round


class Adjusted(NamedTuple):
    """How it ended, iterations, costs before and after, up to how many sigmas an eye agrees, what was seen (n, 2), and
    the layout as it was at the end."""

    ending: int
    iterations: int
    cost_before: float
    cost_after: float
    limit_sigma: float
    seen: Indices
    layout: BundleLayout


def adjust_in_rounds(
    layout: BundleLayout, start: BundleState, state: BundleState, work: BundleWork, settings: BundleSettings
) -> Adjusted:
    """Adjust `state` in place; with `trim`, eyes that disagree leave `layout` and the rest is adjusted again."""
    trial = BundleState(*(array.copy() for array in state))
    seen, iterations_max = seen_counts(layout), settings.iterations_max
    drop_behind(layout, state)
    before = total_cost(layout, start, state)[0]
    if not settings.trim or settings.loss is BundleLoss.NONE:
        ending, spent = minimise(layout, start, state, trial, work, iterations_max, settings.step_tol_sigma)
        noise, latest = _noise(layout, state, work), layout
    else:
        # Huber first: far from the optimum Cauchy has other minima, in which good rays are the outliers
        rough, tol = max(1, int(ROUGH_FRAC * iterations_max)), ROUGH_STEP_SIGMA * np.sqrt(_unknowns(layout))
        ending, spent = minimise(layout._replace(loss=HUBER), start, state, trial, work, rough, tol)
        noise, latest, used = _noise(layout, state, work), layout, 0.0
        everything = layout.scale.copy()
        for _ in range(ROUNDS_MAX):
            changed = _trim(layout, everything, state, work, settings.inlier_sigma * noise)
            if ending == NOT_FINITE or (changed == 0 and abs(noise - used) < STEADY_FRAC * used):
                break
            used, latest = noise, layout._replace(loss_scale=settings.loss_scale * noise)
            left = iterations_max - spent
            ending, more = minimise(latest, start, state, trial, work, left, settings.step_tol_sigma)
            spent += more
            noise = _noise(layout, state, work)
    after = total_cost(layout, start, state)[0]
    return Adjusted(ending, spent, before, after, settings.inlier_sigma * noise, seen, latest)


def _unknowns(layout: BundleLayout) -> int:
    return 6 * layout.n_columns + 3 * int(layout.free.sum())


def _noise(layout: BundleLayout, state: BundleState, work: BundleWork) -> float:
    linearise(layout, state, work)
    return noise_of(layout, work.squares)


def _trim(layout: BundleLayout, everything: Array, state: BundleState, work: BundleWork, limit_sigma: float) -> int:
    """Take eyes that disagree out of `layout`, and those back in that agree by now; how many coordinates changed."""
    before = layout.scale.copy()
    layout.scale[:] = everything
    layout.alive[:] = (everything > 0.0).any(axis=1)
    drop_behind(layout, state)
    linearise(layout, state, work)
    out = work.squares > limit_sigma**2
    if layout.joint:
        out[:, 1] = out[:, 0]
    layout.scale[np.repeat(out, 2, axis=1)] = 0.0
    layout.alive[:] &= (layout.scale > 0.0).any(axis=1)
    return int(((layout.scale > 0.0) != (before > 0.0)).sum())
