"""Questions to a gate module with their right answers: what a probe is, how it asks, and the refusals in full.

A probe takes the module as its argument, so the same probes judge the gate itself and every mutant of it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from protocol.codes import CommandFlag, Interp, Mode, PlcState, RejectCode
from protocol.limits import AxisLimits, LimitTable
from protocol.messages import ZEROS, Axes, Command, Knot

MS = 1_000_000
SLEW = AxisLimits("slew", -2.0, 2.5, 0.5, 2.0)
LIFT = AxisLimits("lift", -0.5, 1.5, 0.25, 1.0)
TABLE = LimitTable((SLEW, LIFT))
AXES = tuple(enumerate(TABLE.axes))
ROUNDING = 1e-9
AT_REST_MOST, BETWEEN = 1e-6, 1.05
Answer = tuple[tuple[Any, ...], ...]
R = RejectCode


@dataclass(frozen=True)
class Probe:
    """A question to a gate module and its answer: refusals as (code, subject, value, limit, unit, remedy)."""

    name: str
    ask: Callable[[Any], Answer]
    answer: Answer
    codes_only: bool = False


# --- building blocks --------------------------------------------------------------------------------------------------


def at(axis: int, value: float, others: float = 0.0) -> Axes:
    return tuple(value if j == axis else others if j < 2 else 0.0 for j in range(8))


def past(value: float, direction: float = math.inf) -> float:
    """The next float."""
    return math.nextafter(value, direction)


def trajectory(knots: Sequence[Knot], first: int = 1, flags: int = CommandFlag.START, **changes: Any) -> Command:
    command = Command(
        9, 5, 0, Mode.TRAJECTORY, axis_mask=3, traj_id=4, knot_first=first, interp=Interp.QUINTIC,
        cmd_flags=CommandFlag(flags), knots=tuple(knots),
    )  # fmt: skip
    return replace(command, **changes)


def servo(q: Axes = ZEROS, qd: Axes = ZEROS, **changes: Any) -> Command:
    command = Command(
        9, 5, 0, Mode.SERVO, axis_mask=3, traj_id=4, interp=Interp.LINEAR, cmd_flags=CommandFlag.START,
        knots=(Knot(0, q, qd),),
    )  # fmt: skip
    return replace(command, **changes)


RUNNING: dict[str, Any] = {
    "plc_state": PlcState.RUN,
    "state_age_ns": 10 * MS,
    "session": 9,
    "nonce": 77,
    "q_ref": ZEROS,
    "knot_before": Knot(50 * MS),
}
HOLDING = RUNNING | {"plc_state": PlcState.HOLD}
LINKED = RUNNING | {"plc_state": PlcState.LINKED}
REST = tuple(Knot(t * MS) for t in (100, 150, 200))
START = tuple(Knot(t * MS) for t in (0, 50, 100))
ARM = Command(9, 5, 0, Mode.ARM, arm_nonce=77)
STOPPED = ("sent", Mode.STOP, (), Interp.NONE, CommandFlag(0), 9, 5)
PASSED = (("sent", "unchanged"),)


def asked(command: Command, view: dict[str, Any], table: LimitTable = TABLE) -> Callable[[Any], Answer]:
    """Ask the gate itself: the refusals, then what it sends."""

    def ask(g: Any) -> Answer:
        verdict = g.gate(command, g.GateView(**view), table)
        sent = verdict.command_to_send
        told = ("sent", "unchanged")
        if sent is not command:
            told = ("sent", sent.mode, sent.knots, sent.interp, sent.cmd_flags, sent.session, sent.seq)
        return (*listed(verdict.refusals), told)

    return ask


def listed(refusals: Sequence[Any]) -> Answer:
    for refusal in refusals:
        whole = f"{refusal.subject} = {refusal.value:.6g} {refusal.unit}, limit {refusal.limit:.6g} {refusal.unit}"
        if refusal.as_line != f"{whole}: {refusal.remedy}":
            return (("text", refusal.text),)
    return tuple((r.code, r.subject, r.value, r.limit, r.unit, r.remedy) for r in refusals)


def passes(name: str, command: Command, view: dict[str, Any] = RUNNING) -> Probe:
    return Probe(f"{name}: passes", asked(command, view), PASSED)


def refused(name: str, command: Command, view: dict[str, Any], *refusals: tuple[Any, ...]) -> Probe:
    return Probe(f"{name}: refused", asked(command, view), (*refusals, STOPPED))


# --- the refusals in full, as the operator reads them -----------------------------------------------------------------


def in_state(mode: str, needs: str, state: PlcState, first: PlcState) -> tuple[Any, ...]:
    return R.MODE_ILLEGAL, "plc_state", state, first, "", f"{mode} needs PLC state {needs}, it is {state.name}"


def stale(age_ns: float) -> tuple[Any, ...]:
    return R.ECHO_STALE, "age of the PLC state", age_ns / MS, 100.0, "ms", "the PLC is not seen; check network and PLC"


def other_session(ours: int, theirs: int) -> tuple[Any, ...]:
    return R.SESSION, "session", ours, theirs, "", "connect again"


def old_nonce(ours: int, theirs: int) -> tuple[Any, ...]:
    return R.NONCE, "arm_nonce", ours, theirs, "", "use the nonce of the newest state"


def limit_q(axis: AxisLimits, t_ms: int, value: float, limit: float) -> tuple[Any, ...]:
    return R.LIMIT_Q, f"{axis.name} at {t_ms} ms: position", value, limit, "rad", "plan inside the joint range"


def limit_qd(axis: AxisLimits, t_ms: int, value: float) -> tuple[Any, ...]:
    return R.LIMIT_QD, f"{axis.name} at {t_ms} ms: speed", value, axis.qd_max, "rad/s", "plan slower"


def limit_qdd(axis: AxisLimits, t_ms: int, value: float) -> tuple[Any, ...]:
    return R.LIMIT_QDD, f"{axis.name} at {t_ms} ms: acceleration", value, axis.qdd_max, "rad/s^2", "plan smoother"


def implied(axis: AxisLimits, a_ms: int, b_ms: int, value: float) -> tuple[Any, ...]:
    subject = f"{axis.name} between {a_ms} and {b_ms} ms: implied speed"
    return R.IMPLIED_SPEED, subject, value, axis.qd_max, "rad/s", "plan slower"


def peak(axis: AxisLimits, a_ms: int, b_ms: int, value: float, limit: float, unit: str) -> tuple[Any, ...]:
    subject = f"{axis.name} between {a_ms} and {b_ms} ms: peak of the quintic"
    return (
        R.CONTINUITY,
        subject,
        value,
        limit * BETWEEN,
        unit,
        "the knots' q, qd and qdd do not belong to one smooth motion",
    )


def spacing(b_ms: int, dt_ns: int, limit_ms: float) -> tuple[Any, ...]:
    return R.KNOT_SPACING, f"knot spacing at {b_ms} ms", dt_ns / MS, limit_ms, "ms", "space knots 5..200 ms apart"


def unused(axis: int, q: float) -> tuple[Any, ...]:
    return R.AXIS_MASK, f"axis {axis}, which is not in use", q, 0, "rad", "leave unused axes 0"


def moving_at(code: RejectCode, which: str, what: str, value: float) -> tuple[Any, ...]:
    unit = "rad/s" if what == "speed" else "rad/s^2"
    return code, f"{what} of the {which} knot", value, AT_REST_MOST, unit, "begin and end at rest"


def off_start(axis: AxisLimits, step: float) -> tuple[Any, ...]:
    return R.START, f"{axis.name}: first knot minus q_ref", step, 1e-5, "rad", "plan from q_ref"


def out_of_reach(axis: AxisLimits, step: float) -> tuple[Any, ...]:
    remedy = "begin at q_ref and move the target in small steps"
    return R.IMPLIED_SPEED, f"{axis.name}: target minus q_ref", step, 0.25 * axis.qd_max, "rad", remedy


def knot_count(n: int, limit: int = 6, what: str = "knots", remedy: str = "send 1 to 6 knots") -> tuple[Any, ...]:
    return R.VALUE, f"number of {what}", n, limit, "", remedy


def speeding(j: int, qd: float, qdd: float, dt_ns: int = 5 * MS) -> tuple[Command, dict[str, Any]]:
    """One knot at qd and qdd that a constant acceleration has brought it to."""
    dt_s = dt_ns / 1e9
    v0 = qd - qdd * dt_s
    before = Knot(50 * MS, ZEROS, at(j, v0), at(j, qdd))
    after = Knot(50 * MS + dt_ns, at(j, 0.5 * (v0 + qd) * dt_s), at(j, qd), at(j, qdd))
    return trajectory((after,)), RUNNING | {"knot_before": before}


# --- judging ----------------------------------------------------------------------------------------------------------


def same(a: Any, b: Any) -> bool:
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and isinstance(b, float):
        return a == b or abs(a - b) <= 1e-9 * max(abs(a), abs(b)) or (math.isnan(a) and math.isnan(b))
    return bool(a == b)


def holds(probe: Probe, g: Any) -> bool:
    """Whether a gate module gives the probe's answer."""
    answer = probe.ask(g)
    if probe.codes_only:
        return probe.answer[0][0] in {row[0] for row in answer} and answer[-1] == STOPPED
    return same(answer, probe.answer)
