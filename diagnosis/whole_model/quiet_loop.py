"""What effects of a valve would change had nothing disturbed the loop: commands as the controller gives them by itself.

Why: a loop answers what disturbs its joint, and the measured command holds that answer. Whatever an effect makes of
such commands predicts the disturbance, which is what the residual is made of. The reference knows nothing of it:
commands that follow from the reference alone are the instrument of closed-loop identification.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.log.tables import fill_gaps
from diagnosis.replay.course import smooth_course
from diagnosis.replay.stage_replay import Replay, StretchReplay
from diagnosis.search.candidates import parameter_sets_with
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, evaluated_at
from machine.effects import kernel
from machine.effects.dynamics import DynamicStage, at_cycles, drive_controller, simulate
from machine.effects.layout import ParameterSets
from machine.rotations import Array

# Of the command, RMS, that is not what the controller gives: beyond it something else commands, too
COMMAND_MISMATCH_MAX_FRAC = 0.2


def quiet_loop(cell: Cell) -> "QuietLoop | None":
    """The loops of a joint's actuator; None where they cannot be run: no controller, no reference, an operator or a
    feed forward that commands the valve as well, or a baseline, which knows what names gain there.
    """
    replay = cell.whitened
    if (
        cell.stage != "actuator"
        or cell.joint is None
        or cell.baseline_gain_nats is not None
        or not isinstance(replay, Replay)
    ):
        return None
    loops = [_closed_loop_part(part, replay.joints) for part in replay.stretch_replays]
    if any(loop is None for loop in loops):
        return None
    found = QuietLoop(cell, replay, tuple(loop for loop in loops if loop is not None))
    return found if found.is_command_reproduced() else None


@dataclass(frozen=True, slots=True)
class QuietLoop:
    """One joint's replay, and its loops with the reference as their only input."""

    cell: Cell
    replay: Replay
    closed_loop_replays: tuple[StretchReplay, ...]

    def is_command_reproduced(self) -> bool:
        """Whether the measured command is what the controller gives of reference and encoders."""
        known, joints = self.cell.upstream_parameters or self.cell.baseline_parameters, self.replay.joints
        off = power = 0.0
        for part, closed in zip(self.replay.stretch_replays, self.closed_loop_replays, strict=True):
            u = simulate(
                closed.plant, _select_joint_parameters(known, joints), closed.stage_input, DynamicStage.CONTROLLER
            ).u[0]
            off += float(((part.stage_input.u[: len(u)] - u) ** 2).sum())
            power += float((part.stage_input.u**2).sum())
        return off <= COMMAND_MISMATCH_MAX_FRAC**2 * power

    def residual_about(self, about: Fit) -> Callable[[ParameterSets], Array]:
        """The residual (sets, N) about a fit, where further effects see commands without the disturbance."""
        left, beyond = evaluated_at(self.cell, self._parameters_of_fit(about))[0], self.driven_replay(about)
        return lambda sets: left + beyond(sets)

    def driven_replay(self, about: Fit) -> Replay:
        """The replay by commands of a loop as a fit says, which leaves nothing by that fit."""
        return self._simulated_replay(about, about)

    def _simulated_replay(self, loop: Fit, rest: Fit) -> Replay:
        """The replay by commands of a loop as one fit says, of encoders that move as another one says."""
        joints, known = (
            self.replay.joints,
            parameter_sets_with(
                self.cell.upstream_parameters or self.cell.baseline_parameters, loop.hypothesis, loop.theta
            ),
        )
        without, parts = self._parameters_of_fit(rest), []
        for part, closed in zip(self.replay.stretch_replays, self.closed_loop_replays, strict=True):
            u = simulate(
                closed.plant, _select_joint_parameters(known, joints), closed.stage_input, DynamicStage.ACTUATOR
            ).u[0]
            drive = replace(part.stage_input, u=np.ascontiguousarray(u), u_start=u[0].copy())
            enc = simulate(part.plant, _select_joint_parameters(without, joints), drive, DynamicStage.ACTUATOR).enc[0]
            parts.append(replace(part, stage_input=drive, measured_output=enc, model_error_by_motion=()))
        return replace(self.replay, stretch_replays=tuple(parts))

    def _parameters_of_fit(self, fit: Fit) -> ParameterSets:
        return parameter_sets_with(self.cell.baseline_parameters, fit.hypothesis, fit.theta)


def _closed_loop_part(part: StretchReplay, joints: tuple[int, ...]) -> StretchReplay | None:
    """A part whose input is the received reference, at every PLC cycle; None where that is not to be had."""
    stretch, plant, own = part.stretch, part.plant, list(joints)
    known = (
        part.stage_input.first_stage is DynamicStage.ACTUATOR and stretch.ref is not None and stretch.enc is not None
    )
    if not known or (plant.joints[:, kernel.KP] <= 0.0).any():
        return None
    ref, enc = (fill_gaps(signal)[:, own] for signal in (stretch.ref, stretch.enc) if signal is not None)
    if not np.isfinite(ref).all():
        return None
    every = replace(plant, log_cycle_s=plant.cycle_s)
    fine_ref, fine_enc = (
        smooth_course(plant, np.ascontiguousarray(signal))[: part.stage_input.n_cycles] for signal in (ref, enc)
    )
    load, load_kg = (
        at_cycles(plant, signal)[: part.stage_input.n_cycles]
        for signal in (part.stage_input.load, part.stage_input.load_kg)
    )
    drive = drive_controller(every, fine_ref, fine_enc, part.stage_input.u[0], fine=True)
    return replace(part, plant=every, stage_input=replace(drive, load=load, load_kg=load_kg))


def _select_joint_parameters(sets: ParameterSets, joints: tuple[int, ...]) -> ParameterSets:
    return ParameterSets(np.ascontiguousarray(sets.joint_parameters[:1, list(joints)]), sets.machine_parameters[:1])
