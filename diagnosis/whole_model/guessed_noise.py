"""The noise of actuators where no command was repeated: the process that no mixture of all effects explains.

Why: a disturbance of the speed goes on over tenths of a second. Counted as white it makes every test fire, and a sound
machine was called faulty. Not from the residual of the model under test: that would hide the gap.
"""

from dataclasses import replace

import numpy as np

from diagnosis.behind.saturated import unexplained_by_mixtures
from diagnosis.noise.floor import AR_ORDER_MAX, Whitener, block_increments, fit_whitener
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.candidates import parameter_sets_with
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, evaluated_at
from diagnosis.whole_model.quiet_loop import quiet_loop
from machine.rotations import Array

CENTRING_WINDOW_ROWS = 400  # 20 s
NOISE_CONVERGENCE_FRAC = 0.05  # change of the noise's size
# Of the motion's own increments: more than this is not noise, but a model that does not fit
NOISE_TO_MOTION_MAX_FRAC = 0.2
NOISE_DEPENDENT_CELL_FIELDS = ("whitened", "rows", "scale", "quiet", "regressors", "t_s")  # by the noise, of a cell


def by_noise_of(cell: Cell, other: Cell) -> Cell:
    """The cell with the other one's noise."""
    return replace(cell, **{name: getattr(other, name) for name in NOISE_DEPENDENT_CELL_FIELDS})


def noise_about(cell: Cell, about: Fit) -> Whitener | None:
    """The filter of a cell's joints; None where what is left is more than noise can be.

    Args:  cell: by its first guess of the noise, which is white; about: the model that effects are added to.
    Model: one linear step in all effects together, its degrees of freedom counted; autoregression of what it leaves.
    Why by commands without the disturbance: effects of a command that follows the noise would take most of it away.
    """
    replay, at = cell.whitened, parameter_sets_with(cell.baseline_parameters, about.hypothesis, about.theta)
    if not isinstance(replay, Replay):
        return None
    quiet = quiet_loop(cell)
    residual = (lambda sets: evaluated_at(cell, sets)) if quiet is None else quiet.residual_about(about)
    left, dof = unexplained_by_mixtures(residual, at, cell.candidates)
    runs = [_centred_residual_runs(cell, left, channel) for channel in range(len(replay.joints))]
    if not all(runs):
        return None
    found = [fit_whitener(own) for own in runs]
    a = np.zeros((AR_ORDER_MAX, len(found)))
    for j, whitener in enumerate(found):
        a[: whitener.lag_count, j] = whitener.ar_coefficients[:, 0]
    unit = replay.whitener.innovation_sigma * np.sqrt(len(left) / dof)
    noise_rms = unit * np.array([np.sqrt(np.mean(np.concatenate(own) ** 2)) for own in runs])
    moved = np.concatenate(
        [block_increments(part.measured_output, part.stretch.dt_s) for part in replay.stretch_replays]
    )
    if (noise_rms > NOISE_TO_MOTION_MAX_FRAC * np.sqrt(np.mean(moved**2, axis=0))).any():
        return None
    order = max(whitener.lag_count for whitener in found)
    return Whitener(a[:order], unit * np.array([float(whitener.innovation_sigma[0]) for whitener in found]))


def _centred_residual_runs(cell: Cell, left: Array, channel: int) -> list[Array]:
    """What is left of one joint (m, 1), stretch by stretch, about its mean over CENTRING_WINDOW_ROWS; those too short
    for a filter are left out.

    Why: a joint that creeps from the middle of a recording on is not noise of its valve, whose filter would follow it.
    """
    own = cell.rows.channel == channel
    runs = [left[own & (cell.rows.series == number)][:, None] for number in np.unique(cell.rows.series[own])]
    return [_about_its_mean(run) for run in runs if len(run) > 2 * AR_ORDER_MAX]


def _about_its_mean(run: Array) -> Array:
    pieces = np.array_split(run, max(1, len(run) // CENTRING_WINDOW_ROWS))
    return np.concatenate([piece - piece.mean(axis=0) for piece in pieces])
