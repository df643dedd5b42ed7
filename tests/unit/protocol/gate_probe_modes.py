"""Probes of the gate's first half: modes and states, trust in what the PLC says, the envelope of a motion."""

import math
from collections.abc import Iterator
from dataclasses import replace

from gate_probes import (
    ARM,
    HOLDING,
    LINKED,
    MS,
    REST,
    RUNNING,
    STOPPED,
    Probe,
    R,
    asked,
    in_state,
    knot_count,
    old_nonce,
    other_session,
    passes,
    past,
    refused,
    servo,
    stale,
    trajectory,
)

from protocol.codes import CommandFlag, Interp, Mode, PlcState
from protocol.messages import Command, Knot

NEEDS = {
    Mode.ARM: ("LINKED or HOLD", (PlcState.LINKED, PlcState.HOLD)),
    Mode.RESET: ("FAULT", (PlcState.FAULT,)),
    Mode.TRAJECTORY: ("HOLD or RUN", (PlcState.HOLD, PlcState.RUN)),
    Mode.SERVO: ("HOLD or RUN", (PlcState.HOLD, PlcState.RUN)),
}
ASK = {Mode.ARM: ARM, Mode.TRAJECTORY: trajectory(REST), Mode.SERVO: servo()}


def mode_probes() -> Iterator[Probe]:
    """Every mode in every PLC state."""
    for mode in Mode:
        command = ASK.get(mode, Command(9, 5, 0, mode))
        for state in PlcState:
            view, name = RUNNING | {"plc_state": state}, f"{mode.name} in {state.name}"
            text, states = NEEDS.get(mode, ("", tuple(PlcState)))
            if state in states:
                yield passes(name, command, view)
            else:
                yield refused(name, command, view, in_state(mode.name, text, state, states[0]))
        if mode not in (Mode.TRAJECTORY, Mode.SERVO):
            home = {Mode.ARM: LINKED, Mode.RESET: RUNNING | {"plc_state": PlcState.FAULT}}.get(mode, RUNNING)
            refusal = (R.VALUE, f"knots in mode {mode.name}", 3, 0, "", "only motions carry knots")
            yield refused(f"knots with {mode.name}", replace(command, knots=REST), home, refusal)
            yield passes(f"{mode.name} without knots", command, home)


def trust_probes() -> Iterator[Probe]:
    """Age of the state, session and nonce, for every mode that rests on them."""
    for name, command, view in (("arm", ARM, LINKED), ("run", trajectory(REST), RUNNING), ("servo", servo(), RUNNING)):
        for age_ns in (0, 1, 100 * MS):
            yield passes(f"{name} at age {age_ns}", command, view | {"state_age_ns": age_ns})
        for age_ns in (-1, 100 * MS + 1, 1 << 62):
            yield refused(f"{name} at age {age_ns}", command, view | {"state_age_ns": age_ns}, stale(age_ns))
        for ours, theirs in ((9, 8), (9, 10), (9, 0), (0, 0), (0, 9), (8, 9)):
            changed = replace(command, session=ours)
            answer = (other_session(ours, theirs), ("sent", *STOPPED[1:5], ours, 5))
            yield Probe(f"{name} {ours} {theirs}", asked(changed, view | {"session": theirs}), answer)
    for ours, theirs in ((77, 76), (76, 77), (0, 0), (77, 0), (0, 77)):
        command, view = replace(ARM, arm_nonce=ours), LINKED | {"nonce": theirs}
        yield refused(f"nonce {ours} {theirs}", command, view, old_nonce(ours, theirs))
    for mode in (Mode.HEARTBEAT, Mode.HOLD, Mode.STOP, Mode.QUICK_STOP, Mode.DISARM):
        yield passes(f"{mode.name} blind", Command(9, 5, 0, mode), RUNNING | {"state_age_ns": 1 << 62, "session": 0})


def envelope_probes() -> Iterator[Probe]:
    """Knot count, interpolation, axis mask, override, number of the trajectory."""
    many = tuple(Knot((100 + 50 * i) * MS) for i in range(8))
    for n in (1, 2, 5, 6):
        yield passes(f"{n} knots", trajectory(many[:n]))
    for n in (0, 7, 8):
        yield refused(f"{n} knots", trajectory(many[:n]), RUNNING, knot_count(n))
    for first, flags in ((0, CommandFlag.START), (1, CommandFlag.LAST_IS_END), (0, CommandFlag.LAST_IS_END)):
        yield refused(f"no knots from {first}", trajectory((), first, flags), HOLDING, knot_count(0))
    for n in (0, 2):
        command = servo(knots=many[:n])
        yield refused(f"{n} targets", command, RUNNING, knot_count(n, 1, "targets", "send one target"))
    for interp in Interp:
        wrong = (R.INTERP, "interp", interp, Interp.QUINTIC, "", "trajectories are quintic")
        run = trajectory(REST, interp=interp)
        yield passes("quintic", run) if interp is Interp.QUINTIC else refused(interp.name, run, RUNNING, wrong)
        wrong = (R.INTERP, "interp", interp, Interp.LINEAR, "", "servo targets are linear")
        target = servo(interp=interp)
        yield passes("linear", target) if interp is Interp.LINEAR else refused(interp.name, target, RUNNING, wrong)
    for command in (trajectory(REST), servo()):
        kind = command.mode.name
        for mask in (0, 1, 2, 7, 0xFF):
            wrong = (R.AXIS_MASK, "axis_mask", mask, 3, "", "use the machine's axes")
            yield refused(f"{kind} mask {mask}", replace(command, axis_mask=mask), RUNNING, wrong)
        for value in (0.0, 0.5, 1.0):
            yield passes(f"{kind} override {value}", replace(command, speed_override=value))
        for value in (past(0.0, -1.0), -1.0, past(1.0), 1.01, math.nan):
            wrong = (R.OVERRIDE, "speed_override", value, 1.0, "", "give 0..1")
            yield refused(f"{kind} override {value}", replace(command, speed_override=value), RUNNING, wrong)
        wrong = (R.TRAJ_ID, "traj_id", 0, 1, "", "number trajectories from 1")
        yield refused(f"{kind} traj_id 0", replace(command, traj_id=0), RUNNING, wrong)
        yield passes(f"{kind} traj_id 1", replace(command, traj_id=1))
