"""The motion gate: the last pure function before the encoder, default deny.

What it does not know to be safe is replaced by a STOP. It answers what may be sent, and for everything it refused:
subject, value, limit, unit and remedy.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from protocol.codes import CommandFlag, Interp, Mode, PlcState, RejectCode
from protocol.layout import KNOTS_PER_COMMAND
from protocol.limits import LimitTable, axis_mask
from protocol.messages import Axes, Command, Knot
from protocol.timeouts import MS, SERVO_TARGET_LEAD_MAX_S, STATE_LATE_TIMEOUT

_ROUNDING = 1e-9  # relative: a planner that plans to the limit is not refused for its last bit
_REST = 1e-6  # rad/s and rad/s^2: rest, up to rounding
_INSIDE = tuple(i / 16.0 for i in range(1, 16))
# Between knots the quintic may exceed the limits by this much: it rounds the corners of the planned profile
_BETWEEN = 1.05


@dataclass(frozen=True, slots=True)
class Refusal:
    """One reason why something may not be sent."""

    code: RejectCode
    subject: str
    value: float
    limit: float
    unit: str
    remedy: str

    @property
    def as_line(self) -> str:
        """The refusal in one line."""
        return f"{self.subject} = {self.value:.6g} {self.unit}, limit {self.limit:.6g} {self.unit}: {self.remedy}"


@dataclass(frozen=True, slots=True)
class GateView:
    """What the PC knows of the PLC at the moment of sending."""

    plc_state: PlcState
    state_age_ns: int
    session: int  # as the PLC reports it
    nonce: int
    q_ref: Axes
    knot_before: Knot | None = None  # the trajectory's knot just before the command's first


@dataclass(frozen=True, slots=True)
class GateVerdict:
    """What may be sent, and why that is not what was requested (empty: it is)."""

    command_to_send: Command
    refusals: tuple[Refusal, ...] = ()


def gate(command: Command, view: GateView, table: LimitTable) -> GateVerdict:
    """Pass the command unchanged, or replace it by a STOP without knots."""
    refusals = tuple(_command_refusals(command, view, table))
    if not refusals:
        return GateVerdict(command)
    return GateVerdict(
        replace(command, mode=Mode.STOP, knots=(), interp=Interp.NONE, cmd_flags=CommandFlag(0)), refusals
    )


def check_trajectory(knots: Sequence[Knot], q_ref: Axes, table: LimitTable) -> tuple[Refusal, ...]:
    """Every reason why a whole trajectory may not be played from the reference `q_ref`; empty if it may."""
    if len(knots) < 2:
        return (
            Refusal(RejectCode.VALUE, "number of knots", len(knots), 2, "", "a trajectory needs a start and an end"),
        )
    return (
        *_start(knots[0], q_ref, table),
        *_knot_sequence_refusals(knots, None, table),
        *_at_rest(knots[-1], RejectCode.END_NOT_AT_REST, "last"),
    )


def check_tail(knots: Sequence[Knot], before: Knot, table: LimitTable) -> tuple[Refusal, ...]:
    """Every reason why `knots` may not follow `before` as the new tail of a trajectory; empty if they may."""
    if not knots:
        return (Refusal(RejectCode.VALUE, "number of knots", 0, 1, "", "a tail needs an end"),)
    return (*_knot_sequence_refusals(knots, before, table), *_at_rest(knots[-1], RejectCode.END_NOT_AT_REST, "last"))


def _command_refusals(command: Command, view: GateView, table: LimitTable) -> Iterator[Refusal]:
    mode = command.mode
    if mode not in (Mode.TRAJECTORY, Mode.SERVO) and command.knots:
        yield Refusal(
            RejectCode.VALUE, f"knots in mode {mode.name}", len(command.knots), 0, "", "only motions carry knots"
        )
    if mode is Mode.ARM:
        yield from _arm_refusals(command, view)
    elif mode is Mode.RESET:
        yield from _in_state(view, (PlcState.FAULT,), "RESET")
    elif mode is Mode.TRAJECTORY:
        yield from _trajectory_refusals(command, view, table)
    elif mode is Mode.SERVO:
        yield from _servo_refusals(command, view, table)


def _in_state(view: GateView, states: tuple[PlcState, ...], subject: str) -> Iterator[Refusal]:
    if view.plc_state not in states:
        names = " or ".join(state.name for state in states)
        remedy = f"{subject} needs PLC state {names}, it is {view.plc_state.name}"
        yield Refusal(RejectCode.MODE_ILLEGAL, "plc_state", view.plc_state, states[0], "", remedy)


def _stale_state_refusals(view: GateView) -> Iterator[Refusal]:
    if not 0 <= view.state_age_ns <= STATE_LATE_TIMEOUT.duration_ns:
        remedy = "the PLC is not seen; check network and PLC"
        yield Refusal(
            RejectCode.ECHO_STALE,
            "age of the PLC state",
            view.state_age_ns / MS,
            STATE_LATE_TIMEOUT.duration_ns / MS,
            "ms",
            remedy,
        )


def _same_session(command: Command, view: GateView) -> Iterator[Refusal]:
    if not command.session or command.session != view.session:
        yield Refusal(RejectCode.SESSION, "session", command.session, view.session, "", "connect again")


def _arm_refusals(command: Command, view: GateView) -> Iterator[Refusal]:
    yield from _in_state(view, (PlcState.LINKED, PlcState.HOLD), "ARM")
    yield from _stale_state_refusals(view)
    yield from _same_session(command, view)
    if not view.nonce or command.arm_nonce != view.nonce:
        yield Refusal(
            RejectCode.NONCE, "arm_nonce", command.arm_nonce, view.nonce, "", "use the nonce of the newest state"
        )


def _trajectory_refusals(command: Command, view: GateView, table: LimitTable) -> Iterator[Refusal]:
    yield from _in_state(view, (PlcState.HOLD, PlcState.RUN), "TRAJECTORY")
    yield from _stale_state_refusals(view)
    yield from _same_session(command, view)
    yield from _trajectory_field_refusals(command, table)
    knots = command.knots
    if not knots:
        return
    if command.knot_first == 0:
        if view.plc_state is not PlcState.RUN:  # once it runs, the reference has left the start
            yield from _start(knots[0], view.q_ref, table)
    elif view.knot_before is None:
        yield Refusal(RejectCode.KNOT_GAP, "first knot", command.knot_first, 0, "", "the knot before it is not known")
    yield from _knot_sequence_refusals(knots, view.knot_before if command.knot_first else None, table)
    if CommandFlag.LAST_IS_END in command.cmd_flags:
        yield from _at_rest(knots[-1], RejectCode.END_NOT_AT_REST, "last")


def _trajectory_field_refusals(command: Command, table: LimitTable) -> Iterator[Refusal]:
    count = len(command.knots)
    if not 1 <= count <= KNOTS_PER_COMMAND:
        yield Refusal(RejectCode.VALUE, "number of knots", count, KNOTS_PER_COMMAND, "", "send 1 to 6 knots")
    if command.interp is not Interp.QUINTIC:
        remedy = "trajectories are quintic"
        yield Refusal(RejectCode.INTERP, "interp", command.interp, Interp.QUINTIC, "", remedy)
    yield from _motion_field_refusals(command, table)


def _motion_field_refusals(command: Command, table: LimitTable) -> Iterator[Refusal]:
    """What every motion carries."""
    if command.axis_mask != axis_mask(table):
        yield Refusal(
            RejectCode.AXIS_MASK, "axis_mask", command.axis_mask, axis_mask(table), "", "use the machine's axes"
        )
    if not 0.0 <= command.speed_override <= 1.0:
        yield Refusal(RejectCode.OVERRIDE, "speed_override", command.speed_override, 1.0, "", "give 0..1")
    if command.traj_id < 1:
        yield Refusal(RejectCode.TRAJ_ID, "traj_id", command.traj_id, 1, "", "number trajectories from 1")


def _servo_refusals(command: Command, view: GateView, table: LimitTable) -> Iterator[Refusal]:
    """One target, in range, not faster than the joints and not far from the reference."""
    yield from _in_state(view, (PlcState.HOLD, PlcState.RUN), "SERVO")
    yield from _stale_state_refusals(view)
    yield from _same_session(command, view)
    yield from _motion_field_refusals(command, table)
    if command.interp is not Interp.LINEAR:
        yield Refusal(RejectCode.INTERP, "interp", command.interp, Interp.LINEAR, "", "servo targets are linear")
    if len(command.knots) != 1:
        yield Refusal(RejectCode.VALUE, "number of targets", len(command.knots), 1, "", "send one target")
        return
    target = command.knots[0]
    yield from _one_knot(target, table)
    for i, axis in enumerate(table.axes):
        step, reach = abs(target.q[i] - view.q_ref[i]), axis.qd_max * SERVO_TARGET_LEAD_MAX_S
        if not step <= reach:
            remedy = "begin at q_ref and move the target in small steps"
            yield Refusal(RejectCode.IMPLIED_SPEED, f"{axis.name}: target minus q_ref", step, reach, "rad", remedy)


def _start(knot: Knot, q_ref: Axes, table: LimitTable) -> Iterator[Refusal]:
    """The first knot is the present reference, at rest, at time zero."""
    if knot.t_ns != 0:
        yield Refusal(RejectCode.START, "time of the first knot", knot.t_ns / MS, 0, "ms", "begin at 0")
    for i, axis in enumerate(table.axes):
        step = abs(knot.q[i] - q_ref[i])
        if not step <= table.start_tolerance_rad:
            yield Refusal(
                RejectCode.START,
                f"{axis.name}: first knot minus q_ref",
                step,
                table.start_tolerance_rad,
                "rad",
                "plan from q_ref",
            )
    yield from _at_rest(knot, RejectCode.START, "first")


def _at_rest(knot: Knot, code: RejectCode, which: str) -> Iterator[Refusal]:
    for name, values, unit in (("speed", knot.qd, "rad/s"), ("acceleration", knot.qdd, "rad/s^2")):
        worst = max(map(abs, values))
        if not worst <= _REST:
            yield Refusal(code, f"{name} of the {which} knot", worst, _REST, unit, "begin and end at rest")


def _knot_sequence_refusals(knots: Sequence[Knot], before: Knot | None, table: LimitTable) -> Iterator[Refusal]:
    """Each knot inside the limits, and each step between neighbours too."""
    previous = before
    for knot in knots:
        yield from _one_knot(knot, table)
        if previous is not None:
            yield from _knot_step_refusals(previous, knot, table)
        previous = knot


def _is_over_limit(value: float, limit: float) -> bool:
    return not abs(value) <= limit * (1.0 + _ROUNDING)


def _one_knot(knot: Knot, table: LimitTable) -> Iterator[Refusal]:
    for i, axis in enumerate(table.axes):
        q, qd, qdd = knot.q[i], knot.qd[i], knot.qdd[i]
        at = f"{axis.name} at {knot.t_ns / MS:.0f} ms"
        if not axis.q_min - _ROUNDING <= q <= axis.q_max + _ROUNDING:
            limit = axis.q_min if q < axis.q_min else axis.q_max
            yield Refusal(RejectCode.LIMIT_Q, f"{at}: position", q, limit, "rad", "plan inside the joint range")
        if _is_over_limit(qd, axis.qd_max):
            yield Refusal(RejectCode.LIMIT_QD, f"{at}: speed", qd, axis.qd_max, "rad/s", "plan slower")
        if _is_over_limit(qdd, axis.qdd_max):
            yield Refusal(RejectCode.LIMIT_QDD, f"{at}: acceleration", qdd, axis.qdd_max, "rad/s^2", "plan smoother")
    for i in range(len(table.axes), len(knot.q)):
        if knot.q[i] or knot.qd[i] or knot.qdd[i]:
            yield Refusal(
                RejectCode.AXIS_MASK, f"axis {i}, which is not in use", knot.q[i], 0, "rad", "leave unused axes 0"
            )


def _knot_step_refusals(a: Knot, b: Knot, table: LimitTable) -> Iterator[Refusal]:
    dt_ns = b.t_ns - a.t_ns
    if not table.spacing_min_ns <= dt_ns <= table.spacing_max_ns:
        limit = table.spacing_min_ns if dt_ns < table.spacing_min_ns else table.spacing_max_ns
        remedy = "space knots 5..200 ms apart"
        yield Refusal(
            RejectCode.KNOT_SPACING, f"knot spacing at {b.t_ns / MS:.0f} ms", dt_ns / MS, limit / MS, "ms", remedy
        )
        return
    dt_s = dt_ns / 1e9
    for i, axis in enumerate(table.axes):
        at = f"{axis.name} between {a.t_ns / MS:.0f} and {b.t_ns / MS:.0f} ms"
        mean = (b.q[i] - a.q[i]) / dt_s
        if _is_over_limit(mean, axis.qd_max):
            yield Refusal(RejectCode.IMPLIED_SPEED, f"{at}: implied speed", mean, axis.qd_max, "rad/s", "plan slower")
        qd, qdd = _quintic_peak(a, b, i, dt_s)
        qd_most, qdd_most = axis.qd_max * _BETWEEN, axis.qdd_max * _BETWEEN
        if _is_over_limit(qd, qd_most) or _is_over_limit(qdd, qdd_most):
            value, limit, unit = (qd, qd_most, "rad/s") if _is_over_limit(qd, qd_most) else (qdd, qdd_most, "rad/s^2")
            remedy = "the knots' q, qd and qdd do not belong to one smooth motion"
            yield Refusal(RejectCode.CONTINUITY, f"{at}: peak of the quintic", value, limit, unit, remedy)


def _quintic_peak(a: Knot, b: Knot, i: int, dt_s: float) -> tuple[float, float]:
    """Largest speed and acceleration of the quintic between two knots of one axis, at fifteen points inside."""
    v0, v1, a0, a1 = a.qd[i], b.qd[i], a.qdd[i], b.qdd[i]
    # q(s) = q0 + v0 T s + a0 T^2/2 s^2 + c3 s^3 + c4 s^4 + c5 s^5 with s = t/T; c3..c5 from the end's q, qd, qdd
    h = b.q[i] - a.q[i] - (v0 + 0.5 * a0 * dt_s) * dt_s
    dv = (v1 - v0 - a0 * dt_s) * dt_s
    da = (a1 - a0) * dt_s * dt_s
    c3, c4, c5 = 10 * h - 4 * dv + 0.5 * da, -15 * h + 7 * dv - da, 6 * h - 3 * dv + 0.5 * da
    qd = qdd = 0.0
    for s in _INSIDE:
        qd = max(qd, abs(v0 + a0 * dt_s * s + (3 * c3 + (4 * c4 + 5 * c5 * s) * s) * s * s / dt_s))
        qdd = max(qdd, abs(a0 + (6 * c3 + (12 * c4 + 20 * c5 * s) * s) * s / (dt_s * dt_s)))
    return qd, qdd
