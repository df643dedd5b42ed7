"""What the page plots: held-out residuals before and after, and the worst held-out trajectory replayed both ways."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.replay.stage_replay import DYNAMIC_STAGE_BY_NAME, STAGE_OUTPUT_SIGNALS, Replay, StretchReplay
from diagnosis.search.candidates import parameter_sets_with
from diagnosis.sliding import is_joint_sliding, unit_of
from diagnosis.whole_model.held_out import HeldOut
from machine.effects.dynamics import simulate
from machine.effects.layout import ParameterSets
from machine.rotations import Array

PLOTTED_CELLS_MAX = 4
STAGE_OUTPUT_LABELS = {"link": "reference received", "controller": "valve command", "actuator": "joint angle"}
SLIDING_SIGNAL_LABELS = {"joint angle": "joint position"}  # of a joint that slides
STAGE_OUTPUT_UNITS = {"link": "rad", "controller": "of full command", "actuator": "rad"}


@dataclass(frozen=True, slots=True)
class CellResiduals:
    """White held-out residuals of one cell, in noise floors, (N,) each, in the order of time.

    `series_index`: which of several measured side by side each belongs to: an axis of a point, a joint's stretch.
    """

    t_s: Array
    residual_without_effects: Array
    residual_with_effects: Array
    series_index: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ReplayedTrajectory:
    """One held-out trajectory of one joint: t_s and outputs (m,) each, in `unit`."""

    segment_kind: str
    joint: int
    signal_label: str
    unit: str
    t_s: Array
    measured_output: Array
    nominal_output: Array
    output_with_effects: Array


@dataclass(frozen=True, slots=True)
class CellCurves:
    """The plots of one cell. `replayed_trajectory` is None where the cell holds no trajectories (points, marker
    corners)."""

    cell_label: str
    named_effects: str
    residuals: CellResiduals
    replayed_trajectory: ReplayedTrajectory | None


def curves_of(cells: Sequence[HeldOut], sliding: tuple[bool, ...]) -> tuple[CellCurves, ...]:
    """Of the cells with the largest gaps, at most four; those with a named effect first."""
    ranked = sorted(cells, key=lambda held_out: (not held_out.fit.hypothesis, -_mean_square_before(held_out)))
    return tuple(_cell_curves(held_out, sliding) for held_out in ranked[:PLOTTED_CELLS_MAX])


def _mean_square_before(held_out: HeldOut) -> float:
    return float(np.mean(held_out.residual_without_effects**2))


def _cell_curves(held_out: HeldOut, sliding: tuple[bool, ...]) -> CellCurves:
    cell = held_out.cell
    named = " + ".join(effect.name for effect in held_out.fit.hypothesis)
    order = np.argsort(cell.t_s, kind="stable")
    before, after = held_out.residual_without_effects, held_out.residual_with_effects
    white = CellResiduals(cell.t_s[order], before[order], after[order], cell.rows.series[order])
    return CellCurves(cell.label, named, white, _replayed_trajectory(held_out, sliding))


def _replayed_trajectory(held_out: HeldOut, sliding: tuple[bool, ...]) -> ReplayedTrajectory | None:
    """The stretch and joint on which the effect matters most, replayed by numbers fitted without that stretch's kind.

    Without a named effect: where the gap is largest; `nominal_output` and `output_with_effects` are then the same.
    """
    replay = held_out.cell.whitened
    if not isinstance(replay, Replay) or not replay.stretch_replays:
        return None
    before, after = (
        _squares_by_stretch(held_out, replay, held_out.residual_without_effects),
        _squares_by_stretch(held_out, replay, held_out.residual_with_effects),
    )
    wanted = before - after if held_out.fit.hypothesis else before
    at, channel = np.unravel_index(int(np.argmax(wanted)), wanted.shape)
    part = replay.stretch_replays[int(at)]
    fold = _fold_of(held_out, int(at) * len(replay.joints) + int(channel))
    theta = held_out.theta_without(fold)
    base = held_out.cell.baseline_parameters
    traces = [
        _simulated_output(replay, part, sets, int(channel))
        for sets in (base, parameter_sets_with(base, held_out.fit.hypothesis, theta))
    ]
    rows, joint = len(traces[0]), replay.joints[int(channel)]
    signal = STAGE_OUTPUT_LABELS[replay.stage]
    return ReplayedTrajectory(
        part.stretch.segment_kind,
        joint + 1,
        SLIDING_SIGNAL_LABELS.get(signal, signal) if is_joint_sliding(sliding, joint) else signal,
        unit_of(STAGE_OUTPUT_UNITS[replay.stage], sliding, joint),
        part.stretch.t_s[:rows] - part.stretch.t_s[0],
        part.measured_output[:rows, int(channel)],
        *traces,
    )


def _squares_by_stretch(held_out: HeldOut, replay: Replay, residual: Array) -> Array:
    """Sum of squared held-out residuals by stretch and channel (parts, joints)."""
    series = held_out.cell.rows.series
    sums = np.bincount(series, weights=residual**2, minlength=len(replay.stretch_replays) * len(replay.joints))
    return np.asarray(sums, dtype=float).reshape(len(replay.stretch_replays), len(replay.joints))


def _fold_of(held_out: HeldOut, series: int) -> int:
    rows = held_out.cell.rows
    return int(rows.fold[np.argmax(rows.series == series)])


def _simulated_output(replay: Replay, part: StretchReplay, sets: ParameterSets, channel: int) -> Array:
    chosen = ParameterSets(np.ascontiguousarray(sets.joint_parameters[:, list(replay.joints)]), sets.machine_parameters)
    traces = simulate(part.plant, chosen, part.stage_input, DYNAMIC_STAGE_BY_NAME[replay.stage])
    return np.asarray(
        getattr(traces, STAGE_OUTPUT_SIGNALS[replay.stage])[0, : len(part.measured_output), channel], dtype=float
    )
