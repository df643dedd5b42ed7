"""How finely a machine, or its simulator, was stepped: no gap, since the nominal model allows any step up to 1 ms.

Where encoders are quiet the model's own step shows, and would be named as a small gain or lag. Joints on which nothing
else is wrong show it, the same for all; where none does, the model's step is kept.
"""

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.cells.dynamic import stage_cells
from diagnosis.noise.floor import block_increments
from diagnosis.replay.replayer import Replayer
from diagnosis.replay.stage_replay import (
    START_SKIPPED_INCREMENTS,
    Replay,
    by_steps,
    part_increments,
    row_weights,
    whiten_sets,
)
from diagnosis.replay.stretches import Stretch
from diagnosis.search.cell import Cell
from machine.effects.layout import ParameterSets
from machine.rotations import Array

RESIDUAL_MEAN_SQUARE_MAX = 1.5  # mean square: what more is left has another cause, too
STEP_REFINEMENT_GRID = np.linspace(0.0, 1.0, 1001)
STEP_REFINEMENT_SIGMA_MAX = 0.1  # standard error, without a measured noise
STEP_REFINEMENT_MARGIN = 0.3  # beyond the ends, by which chance may take a share


@dataclass(frozen=True, slots=True)
class StepShare:
    """A joint's share of the way to endlessly many steps, its standard error, and the mean square that is left."""

    refinement_frac: float
    refinement_sigma: float
    residual_mean_square: float


def at_its_step(replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets) -> Replayer:
    """The replayer with the machine's own step, as far as its joints without a fault show it for sure."""
    if all(replayer.baseline_knows("actuator", j) for j in range(replayer.nominal_machine.n)):
        return replayer
    cells = stage_cells("actuator", replayer, stretches, base, base)
    shares = [
        share_of(cell) for cell in cells if cell.joint and not replayer.baseline_knows("actuator", cell.joint - 1)
    ]
    return replace(replayer, step_refinement_frac=agreed_share([share for share in shares if share is not None]))


def agreed_share(shares: list[StepShare]) -> float:
    """What joints say together: the median by what each knows, as far as it is believed; 0 where none is clean."""
    clean = [
        share
        for share in shares
        if share.residual_mean_square < RESIDUAL_MEAN_SQUARE_MAX
        and -STEP_REFINEMENT_MARGIN <= share.refinement_frac <= 1.0 + STEP_REFINEMENT_MARGIN
    ]
    if not clean:
        return 0.0
    clean.sort(key=lambda one: one.refinement_frac)
    known = np.cumsum([share.refinement_sigma**-2 for share in clean])
    return expected_share(clean[int(np.searchsorted(known, known[-1] / 2.0))])


def expected_share(share: StepShare) -> float:
    """The mean of what a share may be; 0 where that is likelier: half of all simulators step as the model does."""
    likely = np.exp(
        -0.5 * ((STEP_REFINEMENT_GRID - np.clip(share.refinement_frac, 0.0, 1.0)) / share.refinement_sigma) ** 2
    )
    none, finer = float(likely[0]), float(np.mean(likely))
    return 0.0 if none >= finer else float(np.mean(STEP_REFINEMENT_GRID * likely)) / (none + finer)


def share_of(cell: Cell) -> StepShare | None:
    """Least squares over a joint's stretches, together with a shift and another course of the command in each.

    Where the noise was never measured, what is left is the noise, and only a share that it leaves sure is returned: of
    a joint with a fault such a share lies far from any way a machine can have gone.
    """
    replay = cell.whitened
    if not isinstance(replay, Replay):
        return None
    sets = replace(
        cell.baseline_parameters,
        joint_parameters=np.ascontiguousarray(cell.baseline_parameters.joint_parameters[:, list(replay.joints)]),
    )
    both, own, energy, free = 0.0, 0.0, 0.0, -1
    for part in replay.stretch_replays:
        steps, shift = part_increments("actuator", part, sets)
        column = block_increments(by_steps(part), part.stretch.dt_s)[None]
        rows = min(steps.shape[1], column.shape[1])
        signals = [
            signal[:, :rows]
            for signal in (steps, column, shift, *(course[None] for course in part.input_guess_differences))
        ]
        white = [whiten_sets(replay.whitener, signal)[:, START_SKIPPED_INCREMENTS:] for signal in signals]
        left, along, *nuisance = ((signal * row_weights(part, replay.whitener))[0, :, 0] for signal in white)
        if len(left) <= len(nuisance):
            continue
        left, along = _project_out_columns(np.stack([left, along], axis=1), np.stack(nuisance, axis=1)).T
        both, own = both + float(left @ along), own + float(along @ along)
        energy, free = energy + float(left @ left), free + len(left) - len(nuisance)
    if own <= 0.0 or free <= 0:
        return None
    rest = max(energy - both**2 / own, 0.0) / free
    share = StepShare(both / own, float(np.sqrt(rest / own)), rest)
    if cell.floor_known:
        return share
    return replace(share, residual_mean_square=1.0) if share.refinement_sigma < STEP_REFINEMENT_SIGMA_MAX else None


def _project_out_columns(signals: Array, columns: Array) -> Array:
    """Signals (m, k) less what the columns (m, p) can explain of them."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0.0, size, 1.0)
    return signals - scaled @ np.linalg.lstsq(scaled, signals, rcond=1e-9)[0]
