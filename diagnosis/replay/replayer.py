"""Each dynamic stage run with its own measured input: what is left between its output and what was measured."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from diagnosis.datagrams.sent import SentReference
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import fill_gaps
from diagnosis.replay.course import held_rows, late_jump_course, late_jumps, smooth_course
from diagnosis.replay.stretches import Stretch
from machine.effects import kernel
from machine.effects.dynamics import (
    Actuators,
    Drive,
    DynamicStage,
    at_cycles,
    drive_actuator,
    drive_by_sent,
    drive_controller,
    simulate,
)
from machine.effects.layout import ParameterSets, neutral_sets
from machine.effects.structure import loads_along, reference_torques
from machine.rotations import Array

UNIFORM_HALF_WIDTH_SIGMAS = 3.0**0.5  # half the width, in deviations, of what lies anywhere in a range
# Between two references, where they were not logged: what this project's links and most others use
DEFAULT_SEND_PERIOD_S = 0.01


@dataclass(frozen=True, slots=True)
class PreparedStretch:
    """A stretch ready to be replayed with any number of parameter sets: a drive for each stage that it allows.

    `alternative_inputs`: (cycles, n) each, courses that a stage's input may as well have taken between logged rows;
    none where each cycle was logged. `late_jump_inputs`: the drives of stages whose input jumps, with each jump as late
    as it may be: at the end of its logged row, where what was sent is not known. `two_sided_alternatives`: they are of
    datagrams that came a cycle later, and one earlier; not so where what was received was not logged.
    """

    plant: Actuators
    stage_inputs: dict[str, Drive]
    stretch: Stretch
    alternative_inputs: dict[str, tuple[Array, ...]] = field(default_factory=dict)
    late_jump_inputs: dict[str, Drive] = field(default_factory=dict)
    two_sided_alternatives: bool = False


@dataclass(frozen=True, slots=True)
class ReceivedReferences:
    """The received reference at every PLC cycle (cycles, n), and what else it may have been between logged rows.

    `alternatives`: one that stood still from row to row; where what was sent is known, one a cycle later, and one a
    cycle earlier. `late_jump_variant`: one whose jumps come as late as they may; None where nothing is in doubt.
    """

    best_estimate: Array
    alternatives: tuple[Array, ...] = ()
    late_jump_variant: Array | None = None


@dataclass(frozen=True, slots=True)
class _ControllerCommands:
    """What a controller would do of its references at every PLC cycle (cycles, n); None where each cycle is logged,
    or nothing is known.
    """

    best_estimate: Array | None
    alternatives: tuple[Array | None, ...] = ()
    late_jump_variant: Array | None = None


@dataclass(frozen=True, slots=True)
class Replayer:
    """The replays of one machine. `torque_reference`: (n,) [N m], None where masses or limits are not known.

    `step_refinement_frac`: how much of the way from this model's steps to endlessly many the machine's own are found to
    have gone.
    """

    nominal_machine: Nominal
    plant: Actuators
    torque_reference: Array | None
    step_refinement_frac: float = 0.0

    def baseline_knows(self, stage: str, joint: int) -> bool:
        """Whether a baseline knows what the model is wrong by there (joint: 0-based)."""
        return self.nominal_machine.baseline_remainder(stage, joint + 1) is not None

    def prepare(self, stretch: Stretch, course: ParameterSets | None = None) -> PreparedStretch:
        """Each stage's measured input at every PLC cycle.

        Model: between two logged rows an input moves as the stage before it says (by `course`, nominal without),
               corrected linearly so that it meets both rows: a jump of the reference falls on its own cycle. Where what
               was sent is not known, the reference may as well have stood still until the next row.
        """
        known = neutral_sets(self.nominal_machine.n) if course is None else course
        plant = self.at_rate(stretch.dt_s)
        out = PreparedStretch(plant, {}, stretch)
        ref, enc, u = (
            None if signal is None else fill_gaps(signal) for signal in (stretch.ref, stretch.enc, stretch.u)
        )
        ref_fine = None if ref is None else self._received_reference(out, ref, known)
        if u is None or enc is None:
            return out
        if ref is None or ref_fine is None or not self.nominal_machine.has_controller:
            return self._prepare_actuator_drives(out, enc, u, _ControllerCommands(None))
        out = replace(out, two_sided_alternatives=stretch.sent_reference is not None)
        commands = self._controller_commands(
            out, self._reference_alternatives(out, ref, ref_fine, known), (enc, u), known
        )
        return self._prepare_actuator_drives(out, enc, u, commands)

    def received_references(self, stretch: Stretch, course: ParameterSets | None = None) -> ReceivedReferences | None:
        """What the PLC received; None where it was not logged. `course`: see `prepare`."""
        if stretch.ref is None:
            return None
        known = neutral_sets(self.nominal_machine.n) if course is None else course
        out, ref = PreparedStretch(self.at_rate(stretch.dt_s), {}, stretch), fill_gaps(stretch.ref)
        return self._reference_alternatives(out, ref, self._received_reference(out, ref, known), known)

    def _received_reference(self, out: PreparedStretch, ref: Array, known: ParameterSets) -> Array:
        """The received reference at every PLC cycle; the link's drive goes to `out` where what was sent is known."""
        plant, sent = out.plant, out.stretch.sent_reference
        if sent is None:
            return smooth_course(plant, ref)
        out.stage_inputs["link"] = _link_drive(out, sent, sent.t_s)
        return _course_through_rows(
            plant, ref, self._output_every_cycle("link", plant, out.stage_inputs["link"], known)
        )

    def _shifted_reference(
        self, out: PreparedStretch, sent: SentReference, ref: Array, known: ParameterSets, by_s: float
    ) -> Array:
        """The received reference (cycles, n), had each datagram come so much later, as far as its log rows allow it."""
        plant = out.plant
        moved = within_rows(sent, by_s, plant.transport_delay_s + float(known.machine_parameters[0, kernel.DELAY]))
        drive = _link_drive(out, sent, moved)
        return _course_through_rows(plant, ref, self._output_every_cycle("link", plant, drive, known))

    def _reference_alternatives(
        self, out: PreparedStretch, ref: Array, fine: Array, known: ParameterSets
    ) -> ReceivedReferences:
        """From the logged rows (rows, n) and their course (cycles, n)."""
        plant, sent = out.plant, out.stretch.sent_reference
        if plant.cycles_per_row == 1 or (sent is not None and sent.unsure_s == 0.0):
            return ReceivedReferences(fine)
        if sent is None:
            return ReceivedReferences(fine, (held_rows(plant, ref),), late_jumps(plant, ref, fine))
        others = [self._shifted_reference(out, sent, ref, known, by_s) for by_s in (plant.cycle_s, -plant.cycle_s)]
        by_s = plant.cycle_s * np.ceil(UNIFORM_HALF_WIDTH_SIGMAS * sent.unsure_s / plant.cycle_s)
        return ReceivedReferences(fine, tuple(others), self._shifted_reference(out, sent, ref, known, by_s))

    def _controller_commands(
        self, out: PreparedStretch, references: ReceivedReferences, signals: tuple[Array, Array], known: ParameterSets
    ) -> _ControllerCommands:
        """The controller's courses from references, encoders and commands; its drives go to `out`."""
        plant, (enc, u) = out.plant, signals
        seen = smooth_course(plant, enc)

        def driven(course: Array) -> tuple[Drive, Array | None]:
            drive = drive_controller(plant, course, seen, u[0], fine=True)
            return drive, self._output_every_cycle("controller", plant, drive, known)

        out.stage_inputs["controller"], own = driven(references.best_estimate)
        if out.two_sided_alternatives and references.alternatives:
            out.alternative_inputs["controller"] = references.alternatives
        jumped = None
        if references.late_jump_variant is not None:
            out.late_jump_inputs["controller"], jumped = driven(references.late_jump_variant)
        return _ControllerCommands(own, tuple(driven(other)[1] for other in references.alternatives), jumped)

    def _prepare_actuator_drives(
        self, out: PreparedStretch, enc: Array, u: Array, commands: _ControllerCommands
    ) -> PreparedStretch:
        """With the actuators' drive, and with the other courses that the commands may have taken."""
        plant, loads = out.plant, self.loads_along(enc)

        def driven(course: Array) -> Drive:
            return drive_actuator(plant, course, enc[0], loads, fine=True)

        if commands.best_estimate is None:
            course = smooth_course(plant, u)
            out.stage_inputs["actuator"] = driven(course)
            if plant.cycles_per_row == 1:
                return out
            jumped = late_jump_course(plant, u)
            others = [jumped]
            if self.nominal_machine.has_controller:  # the mean between rows may be larger than the rows show
                others.append(course * (1.0 + self._command_ripple()))
        else:
            out.stage_inputs["actuator"] = driven(_course_through_rows(plant, u, commands.best_estimate))
            others = [_course_through_rows(plant, u, other) for other in commands.alternatives]
            jumped = (
                None
                if commands.late_jump_variant is None
                else _course_through_rows(plant, u, commands.late_jump_variant)
            )
        if jumped is not None:
            out.late_jump_inputs["actuator"] = driven(jumped)
        out.alternative_inputs["actuator"] = tuple(others)
        return out

    def _command_ripple(self) -> Array:
        """Share (n,) by which a command may be off its mean wherever it is sampled.

        Model: a reference that steps every T makes teeth of kp v T, v = Kv u: half of one is kp Kv T / 2 of u.
        """
        return 0.5 * DEFAULT_SEND_PERIOD_S * self.plant.joints[:, kernel.KP] * self.plant.joints[:, kernel.KV]

    def stage_outputs(self, stage: str, prepared: PreparedStretch, sets: ParameterSets) -> Array | None:
        """What every set gives for a stage's output (sets, rows, n); None where the stretch has no input or output."""
        drive = prepared.stage_inputs.get(stage)
        return None if drive is None else _stage_output(stage, prepared.plant, sets, drive)

    def residuals(self, stage: str, prepared: PreparedStretch, sets: ParameterSets) -> Array | None:
        """Measured less modelled, (sets, rows, n), in the stage's unit; NaN in columns that were not recorded."""
        modelled, measured = self.stage_outputs(stage, prepared, sets), measured_output(stage, prepared.stretch)
        if modelled is None or measured is None:
            return None
        out = fill_gaps(measured)[: modelled.shape[1]] - modelled
        for signal in _logged_signals(stage, prepared.stretch):
            out[..., ~np.isfinite(signal).any(axis=0)] = np.nan
        return out

    def at_rate(self, dt_s: float) -> Actuators:
        """The plant logged at the recording's own rate, a whole number of PLC cycles."""
        cycles = max(1, round(dt_s / self.plant.cycle_s))
        return replace(self.plant, log_cycle_s=cycles * self.plant.cycle_s)

    def _output_every_cycle(self, stage: str, plant: Actuators, drive: Drive, course: ParameterSets) -> Array | None:
        """The stage's output at every PLC cycle (cycles, n); None where each is logged anyway."""
        if plant.cycles_per_row == 1:
            return None
        every = replace(plant, log_cycle_s=plant.cycle_s)
        none = np.zeros((drive.n_cycles, plant.n))
        return _stage_output(stage, every, course, replace(drive, load=none, load_kg=none))[0]

    def loads_along(self, enc: Array) -> tuple[Array, Array] | None:
        """Load and load per kg along encoders (rows, n); None where masses or limits are not known."""
        if self.torque_reference is None or self.nominal_machine.arm is None:
            return None
        return loads_along(self.nominal_machine.arm, neutral_sets(self.nominal_machine.n), enc, self.torque_reference)


def within_rows(sent: SentReference, by_s: float | Array, delay_s: float) -> Array:
    """When each datagram (k,) was sent, moved by so much as its log rows allow of its arrival `delay_s` later."""
    moved = sent.t_s + by_s
    if sent.within_s is not None:
        earliest, latest = sent.within_s - delay_s
        moved = np.minimum(moved, np.maximum(latest, sent.t_s))
        moved = np.maximum(moved, np.minimum(earliest, sent.t_s))
    return np.maximum.accumulate(moved)


def _link_drive(out: PreparedStretch, sent: SentReference, t_s: Array) -> Drive:
    """What drives the link where the datagrams (k,) are taken at t_s (k,)."""
    plant, stretch = out.plant, out.stretch
    cycles = (stretch.row_count - 1) * plant.cycles_per_row + 1
    return drive_by_sent(plant, t_s, sent.q, float(stretch.t_s[0]), cycles, lost=sent.datagram_lost)


def _stage_output(stage: str, plant: Actuators, sets: ParameterSets, drive: Drive) -> Array:
    last = {"link": DynamicStage.LINK, "controller": DynamicStage.CONTROLLER, "actuator": DynamicStage.ACTUATOR}[stage]
    traces = simulate(plant, sets, drive, last)
    return {"link": traces.ref, "controller": traces.u, "actuator": traces.enc}[stage]


def _course_through_rows(plant: Actuators, logged: Array, between: Array | None) -> Array:
    """Logged rows at every PLC cycle (cycles, n): on a modelled course `between`, corrected to meet each row."""
    if between is None:
        return at_cycles(plant, logged)
    return between + at_cycles(plant, logged - between[:: plant.cycles_per_row])


def replayer_of(nominal: Nominal, stretches: Sequence[Stretch]) -> Replayer | None:
    """The replays of a machine; None where its file has no actuators. `stretches` of the recording show the range of
    joints whose limits the file does not give.
    """
    if nominal.actuators is None:
        return None
    low, high = nominal.q_min, nominal.q_max
    seen = [fill_gaps(stretch.enc) for stretch in stretches if stretch.enc is not None]
    if seen:
        low, high = (
            np.where(np.isfinite(limit), limit, of(np.concatenate(seen), axis=0))
            for limit, of in ((low, np.nanmin), (high, np.nanmax))
        )
    limited = np.isfinite(low).all() and np.isfinite(high).all()
    weighed = nominal.arm is not None and float(nominal.arm.mass.sum()) > 0.0
    torque = None
    if nominal.arm is not None and limited and weighed:
        torque = reference_torques(nominal.arm, neutral_sets(nominal.n), low, high)
    return Replayer(nominal, nominal.actuators, torque)


def closed_loop(replayer: Replayer, stretch: Stretch) -> tuple[Actuators, Drive, Array] | None:
    """Plant, drive from what was sent (or received) with the loop closed, and the encoders (rows, n); None without."""
    if stretch.enc is None or not np.isfinite(stretch.enc).all():
        return None
    prepared = replayer.prepare(stretch)
    drive = prepared.stage_inputs.get("link")
    if drive is None:
        if stretch.ref is None or not np.isfinite(stretch.ref).all():
            return None
        u = np.zeros(replayer.nominal_machine.n) if stretch.u is None else np.nan_to_num(stretch.u[0])
        drive = drive_controller(prepared.plant, stretch.ref, stretch.enc, u)
    drive = replace(drive, enc_start=stretch.enc[0].copy())  # inside a dead band a joint rests anywhere
    loads = replayer.loads_along(stretch.enc)
    if loads is not None:
        drive = replace(drive, load=loads[0], load_kg=loads[1])
    return prepared.plant, drive, stretch.enc


def measured_output(stage: str, stretch: Stretch) -> Array | None:
    """What was measured of a stage's output (rows, n)."""
    return {"link": stretch.ref, "controller": stretch.u, "actuator": stretch.enc}.get(stage)


def _logged_signals(stage: str, stretch: Stretch) -> tuple[Array, ...]:
    """The logged signals that a stage's residual rests on."""
    signals = {
        "link": (stretch.ref,),
        "controller": (stretch.ref, stretch.enc, stretch.u),
        "actuator": (stretch.u, stretch.enc),
    }[stage]
    return tuple(signal for signal in signals if signal is not None)
