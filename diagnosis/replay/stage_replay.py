"""A dynamic stage's residual for any parameters: 20 Hz increments of measured less replayed, white by its noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.errors import DiagnosisError
from diagnosis.log.tables import fill_gaps
from diagnosis.noise.floor import BLOCK_DURATION_S, Whitener
from diagnosis.noise.of_a_day import DayNoise
from diagnosis.replay.replayer import PreparedStretch, Replayer, measured_output
from diagnosis.replay.side_by_side import side_by_side
from diagnosis.replay.stretches import Stretch
from machine.effects.dynamics import Actuators, Drive, DynamicStage, simulate
from machine.effects.kernel import BREAKAWAY, BREAKAWAY_ONCE, LAG
from machine.effects.layout import ParameterSets, neutral_sets
from machine.rotations import Array

DYNAMIC_STAGE_BY_NAME = {
    "link": DynamicStage.LINK,
    "controller": DynamicStage.CONTROLLER,
    "actuator": DynamicStage.ACTUATOR,
}
STAGE_OUTPUT_SIGNALS = {"link": "ref", "controller": "u", "actuator": "enc"}
START_SKIPPED_INCREMENTS = 10  # increments at a stretch's start: the valve's state is not known there
TIMING_UNCERTAINTY_S = 1.5e-3
GAUSS_SEIDEL_SWEEPS = 3
TIMING_ALTERNATIVES = 2  # courses in addition to what was sent: a cycle later, and one earlier
POWER_EPSILON = 1e-12
UNIFORM_SIGMA_PER_HALF_WIDTH = 3.0**-0.5  # standard deviation of what lies anywhere between -1 and 1


@dataclass(frozen=True, slots=True)
class StretchReplay:
    """One stretch's replay for some joints (0-based): what drives it, and what was measured (rows, joints).

    `input_guess_differences`: (m, joints) each, how far another guess of the input's course between logged rows drives
    the increments apart; `two_sided_alternatives`: two such guesses at most, one a cycle later and one earlier.
    `jump_timing_differences`: (m, joints), the same of jumps that each may be anywhere in its row; None where no row
    hides one. `valve_delay_differences`: (m, joints), the same of valves that are TIMING_UNCERTAINTY_S slower, where
    the joints' loops run through them; None where the valve commands are known: what is late there comes late, and no
    more.
    `model_error_by_motion`: by joint, what is known of its model beyond what has been taken off `measured_output`, if
    it moves like a given course (m,); empty, or None, where nothing is.
    """

    plant: Actuators
    stage_input: Drive
    measured_output: Array
    stretch: Stretch
    input_guess_differences: tuple[Array, ...] = ()
    two_sided_alternatives: bool = False
    jump_timing_differences: Array | None = None
    valve_delay_differences: Array | None = None
    model_error_by_motion: tuple[Callable[[Array], Array] | None, ...] = ()


@dataclass(frozen=True, slots=True)
class Replay:
    """The whitened residual of a stage for some joints, over several stretches.

    `day_to_day_noise`: what the machine's numbers wander by from day to day, where that is known.
    """

    stage: str
    joints: tuple[int, ...]
    stretch_replays: tuple[StretchReplay, ...]
    whitener: Whitener
    day_to_day_noise: DayNoise | None = None

    def __call__(self, sets: ParameterSets) -> Array:
        """Residuals (sets, N): stretches end to end, channels within each."""
        chosen = ParameterSets(
            np.ascontiguousarray(sets.joint_parameters[:, list(self.joints)]), sets.machine_parameters
        )
        out = np.concatenate(
            side_by_side(lambda part: self._whitened_residual(part, chosen), self.stretch_replays), axis=1
        )
        return out if self.day_to_day_noise is None else self.day_to_day_noise.whiten(out)

    def _whitened_residual(self, part: StretchReplay, sets: ParameterSets) -> Array:
        steps, shift = part_increments(self.stage, part, sets)
        weight = row_weights(part, self.whitener)
        white = whiten_sets(self.whitener, steps)[:, START_SKIPPED_INCREMENTS:] * weight
        sent = part.stretch.sent_reference
        least, most = -1.0, 1.0
        if part.two_sided_alternatives and sent is not None:  # one to either side
            least, most = -min(1.0, sent.unsure_s / part.plant.cycle_s), 0.0
        guesses = [(difference[None], least, most) for difference in part.input_guess_differences]
        if part.valve_delay_differences is not None:
            guesses.append((part.valve_delay_differences[None], -1.0, 1.0))
        if self.stage == "actuator":
            guesses.append((shift, -TIMING_UNCERTAINTY_S, TIMING_UNCERTAINTY_S))
        if guesses:
            columns = [
                (whiten_sets(self.whitener, signal)[:, START_SKIPPED_INCREMENTS:] * weight, a, b)
                for signal, a, b in guesses
            ]
            white = _remove_log_uncertainty(white, columns)
        return white.transpose(0, 2, 1).reshape(len(white), -1)


def row_weights(part: StretchReplay, whitener: Whitener) -> Array | float:
    """The weight of rows (1, m, joints): those after a jump that may be anywhere in its row count less.

    Model: 1 / (1 + x^2) over the jump's standard deviation x: near the noise a row counts as chance would have it, far
           above it not at all, rather than one deviation each time.
    """
    if part.jump_timing_differences is None:
        return 1.0
    return 1.0 / (
        1.0
        + (
            UNIFORM_SIGMA_PER_HALF_WIDTH
            * whiten_sets(whitener, part.jump_timing_differences[None])[:, START_SKIPPED_INCREMENTS:]
        )
        ** 2
    )


def _remove_log_uncertainty(white: Array, columns: list[tuple[Array, float, float]]) -> Array:
    """Residuals without what the log's own coarseness can explain, per set and joint.

    Why: logs are stamped to a cycle, and models stepped at 0.5 and at 1 ms lie as far apart; between two logged rows
    the command's course is a guess. At most once the difference of two guesses, and a shift of at most
    TIMING_UNCERTAINTY_S (of the encoders, and in a loop that is run as a whole of the valve in it), are no effects:
    each column with its least and its most amount. Solved in turn (Gauss-Seidel), the courses first: what both can
    explain is theirs.
    """
    products = [[(a * b).sum(axis=1) for b, _, _ in columns] for a, _, _ in columns]
    wanted = [-(column * white).sum(axis=1) for column, _, _ in columns]
    amounts = [np.zeros_like(amount) for amount in wanted]
    for _ in range(GAUSS_SEIDEL_SWEEPS):
        for k, (_, least, most) in enumerate(columns):
            others = sum(products[k][i] * amounts[i] for i in range(len(columns)) if i != k)
            power = np.where(products[k][k] > POWER_EPSILON, products[k][k], np.inf)
            amounts[k] = np.clip((wanted[k] - others) / power, least, most)
    left = white
    for amount, (column, _, _) in zip(amounts, columns, strict=True):
        left = left + amount[:, None] * column
    return left


def part_increments(stage: str, part: StretchReplay, sets: ParameterSets) -> tuple[Array, Array]:
    """20 Hz increments (sets, m, joints) of measured less replayed, and their change per second of delay."""
    traces = simulate(part.plant, sets, part.stage_input, DYNAMIC_STAGE_BY_NAME[stage])
    modelled = getattr(traces, STAGE_OUTPUT_SIGNALS[stage])
    error = part.measured_output[None, : modelled.shape[1]] - modelled
    for channel, otherwise in enumerate(part.model_error_by_motion):
        if otherwise is None:
            continue
        for k in np.nonzero(sets.joint_parameters[:, channel, [BREAKAWAY, BREAKAWAY_ONCE]].any(axis=1))[0]:
            error[k, :, channel] -= otherwise(modelled[k, :, channel])
    size = max(1, round(BLOCK_DURATION_S / part.stretch.dt_s))
    rows = error.shape[1] // size * size
    shape = (len(error), -1, size, error.shape[2])
    means = error[:, :rows].reshape(shape).mean(axis=2)
    return np.diff(means, axis=1), np.diff(_block_mean_slopes(modelled[:, :rows], size, part.stretch.dt_s), axis=1)


def _block_mean_slopes(x: Array, size: int, dt_s: float) -> Array:
    """Means (sets, blocks, joints) of central differences (sets, rows, joints) over blocks of so many rows: of all rows
    inside a block those at its two ends are left.
    """
    ends = x[:, ::size].copy()
    ends[:, 1:] += x[:, size - 1 : -1 : size]
    ends[:, 0] += 2.0 * x[:, 0] - x[:, 1]
    last = 3.0 * x[:, -1:] - x[:, -2:-1]
    return np.diff(np.concatenate([ends, last], axis=1), axis=1) / (2.0 * dt_s * size)


def whiten_sets(whitener: Whitener, steps: Array) -> Array:
    """White residuals (sets, m - order, n) of increments (sets, m, n)."""
    p = whitener.lag_count
    out = steps[:, p:].copy()
    for i in range(p):
        out -= whitener.ar_coefficients[i] * steps[:, p - 1 - i : steps.shape[1] - 1 - i]
    return out / whitener.innovation_sigma


def part_of(stage: str, prepared: PreparedStretch, joints: list[int], replayer: Replayer) -> StretchReplay:
    """One stretch's replay narrowed to some joints (0-based)."""
    drive = prepared.stage_inputs[stage]
    signals = {name: getattr(drive, name) for name in ("sent", "ref", "enc", "u", "load", "load_kg")}
    cut = {name: np.ascontiguousarray(values[:, joints]) for name, values in signals.items()}
    narrowed = replace(drive, **cut, enc_start=drive.enc_start[joints].copy(), u_start=drive.u_start[joints].copy())
    plant = replace(prepared.plant, joints=prepared.plant.joints[joints])
    output = measured_output(stage, prepared.stretch)
    if output is None:
        raise DiagnosisError(f"{prepared.stretch.name}: the output of stage {stage} was not recorded")
    measured = fill_gaps(output)[:, joints]
    part = StretchReplay(plant, narrowed, measured, prepared.stretch)
    finer = np.array([0.0 if replayer.baseline_knows(stage, j) else replayer.step_refinement_frac for j in joints])
    if stage == "actuator" and finer.any():
        part = replace(part, measured_output=measured - finer * by_steps(part)[: len(measured)])
    own = part_increments(stage, part, neutral_sets(len(joints)))[0][0]

    def apart(**inputs: Array) -> Array:
        other = replace(
            part,
            stage_input=replace(part.stage_input, **{k: np.ascontiguousarray(x[:, joints]) for k, x in inputs.items()}),
        )
        return own - part_increments(stage, other, neutral_sets(len(joints)))[0][0]

    signal = "u" if drive.first_stage is DynamicStage.ACTUATOR else "ref"
    jumped = prepared.late_jump_inputs.get(stage)
    unsure = None if jumped is None else apart(**{signal: getattr(jumped, signal)})
    between = tuple(apart(**{signal: course}) for course in prepared.alternative_inputs.get(stage, ()))
    slower = None
    if stage == "actuator" and drive.first_stage < DynamicStage.ACTUATOR:
        slower = own - part_increments(stage, part, _late_valves(len(joints)))[0][0]
    return replace(
        part,
        input_guess_differences=between,
        two_sided_alternatives=prepared.two_sided_alternatives,
        jump_timing_differences=unsure,
        valve_delay_differences=slower,
    )


def _late_valves(joints: int) -> ParameterSets:
    sets = neutral_sets(joints)
    sets.joint_parameters[..., LAG] = TIMING_UNCERTAINTY_S
    return sets


def by_steps(part: StretchReplay) -> Array:
    """What an endless number of steps changes in the modelled course (rows, joints), to first order in the step."""
    own, half = (
        simulate(replace(part.plant, step_refinement_factor=times), neutral_sets(part.plant.n), part.stage_input).enc[0]
        for times in (1, 2)
    )
    return 2.0 * (half - own)


def white_rows(part: StretchReplay, order: int) -> int:
    """White residuals of one channel in a part."""
    size = max(1, round(BLOCK_DURATION_S / part.stretch.dt_s))
    return max(0, len(part.measured_output) // size - 1 - order - START_SKIPPED_INCREMENTS)
