"""The motion gate: every limit swept past both sides, and the gate mutated to prove that the cases bite."""

import ast
import inspect
import types
from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest

from protocol import gate as gate_module
from protocol.codes import CommandFlag, Interp, Mode, PlcState, RejectCode
from protocol.gate import GateView, check_trajectory, gate
from protocol.limits import AxisLimits, LimitTable
from protocol.messages import ZEROS, Axes, Command, Knot

MS = 1_000_000
TABLE = LimitTable((AxisLimits("slew", -2.0, 2.5, 0.5, 2.0), AxisLimits("lift", -0.5, 1.5, 0.25, 1.0)))
HERE = (0.3, 0.2, *ZEROS[2:])
VIEW = GateView(PlcState.RUN, 10 * MS, session=9, nonce=77, q_ref=HERE, knot_before=Knot(50 * MS, HERE))


def moving(
    axis: int, qd: float = 0.0, qdd: float = 0.0, dt_ns: int = 50 * MS, n: int = 3, q0: Axes = HERE
) -> tuple[Knot, ...]:
    """n knots of a constant acceleration that reaches `qd` at the last one, beginning dt after 50 ms."""
    dt_s = dt_ns / 1e9
    knots = []
    for i in range(1, n + 1):
        t_s = i * dt_s
        t_left_s = (n - i) * dt_s
        speed = qd - qdd * t_left_s
        q, v, a = list(q0), [0.0] * 8, [0.0] * 8
        q[axis] += (qd - qdd * n * dt_s) * t_s + 0.5 * qdd * t_s * t_s
        v[axis], a[axis] = speed, qdd
        knots.append(Knot(50 * MS + i * dt_ns, tuple(q), tuple(v), tuple(a)))
    return tuple(knots)


def before(knots: tuple[Knot, ...], axis: int) -> Knot:
    """The knot one step before the first of `moving`."""
    a = knots[0].qdd[axis]
    dt_s = (knots[0].t_ns - 50 * MS) / 1e9
    v = [0.0] * 8
    v[axis] = knots[0].qd[axis] - a * dt_s
    return Knot(50 * MS, HERE, tuple(v), knots[0].qdd)


def trajectory(knots: tuple[Knot, ...], first: int = 2, flags: CommandFlag = CommandFlag.START) -> Command:
    return Command(
        9,
        5,
        0,
        Mode.TRAJECTORY,
        axis_mask=3,
        traj_id=4,
        knot_first=first,
        interp=Interp.QUINTIC,
        cmd_flags=flags,
        knots=knots,
    )


def servo(**changes: object) -> Command:
    there = Knot(0, (0.4, 0.15, *ZEROS[2:]), (0.1, -0.1, *ZEROS[2:]))
    command = Command(9, 5, 0, Mode.SERVO, axis_mask=3, traj_id=4, interp=Interp.LINEAR, knots=(there,))
    return replace(command, **changes)  # type: ignore[arg-type]


REST = tuple(Knot(t * MS, HERE) for t in (100, 150, 200))
START = tuple(Knot(t * MS, HERE) for t in (0, 50, 100))
HOLDING = replace(VIEW, plc_state=PlcState.HOLD)
GOOD: tuple[tuple[str, Command, GateView], ...] = (
    ("running", trajectory(REST), VIEW),
    ("starting", trajectory(START, first=0), HOLDING),
    ("ending", trajectory(REST, flags=CommandFlag.LAST_IS_END), VIEW),
    ("prefill", trajectory(REST), HOLDING),
    ("servo", servo(), VIEW),
    ("servo starting", servo(cmd_flags=CommandFlag.START), HOLDING),
    ("servo at its reach", servo(knots=(Knot(0, (0.3 + 0.124999, 0.2, *ZEROS[2:])),)), VIEW),
    ("arm", Command(9, 5, 0, Mode.ARM, arm_nonce=77), replace(VIEW, plc_state=PlcState.LINKED)),
    ("arm again", Command(9, 5, 0, Mode.ARM, arm_nonce=77), HOLDING),
    ("reset", Command(9, 5, 0, Mode.RESET), replace(VIEW, plc_state=PlcState.FAULT)),
    *(
        (mode.name, Command(9, 5, 0, mode), replace(VIEW, state_age_ns=10**12, session=0))
        for mode in (Mode.HEARTBEAT, Mode.HOLD, Mode.STOP, Mode.QUICK_STOP, Mode.DISARM)
    ),
)


@pytest.mark.parametrize(("name", "command", "view"), GOOD)
def test_what_is_safe_passes_unchanged(name: str, command: Command, view: GateView) -> None:
    verdict = gate(command, view, TABLE)
    assert verdict.refusals == (), name
    assert verdict.command_to_send is command


def with_value(knots: tuple[Knot, ...], index: int, axis: int, **values: float) -> tuple[Knot, ...]:
    changed = {}
    for name, value in values.items():
        array = list(getattr(knots[index], name))
        array[axis] = value
        changed[name] = tuple(array)
    return (*knots[:index], replace(knots[index], **changed), *knots[index + 1 :])


@dataclass(frozen=True)
class Bad:
    name: str
    code: RejectCode
    command: Command
    view: GateView = VIEW


def hump() -> Bad:
    """0.46 rad/s at two knots 200 ms and 0.1 rad apart: between them 0.53 rad/s, at a permitted acceleration."""
    a, b = (Knot(t * MS, (0.3 + q, *HERE[1:]), (0.46, *ZEROS[1:])) for t, q in ((50, 0.0), (250, 0.1)))
    return Bad("hump between knots", RejectCode.CONTINUITY, trajectory((b,)), replace(VIEW, knot_before=a))


def bad_cases() -> list[Bad]:
    arm = Command(9, 5, 0, Mode.ARM, arm_nonce=77)
    linked = replace(VIEW, plc_state=PlcState.LINKED)
    moved = tuple(replace(k, q=(0.3 + 2e-5, *k.q[1:])) for k in START)
    cases = [
        Bad("knots in a heartbeat", RejectCode.VALUE, Command(9, 5, 0, knots=REST)),
        Bad("servo without a target", RejectCode.VALUE, servo(knots=())),
        Bad("servo with two targets", RejectCode.VALUE, servo(knots=servo().knots * 2)),
        Bad("servo quintic", RejectCode.INTERP, servo(interp=Interp.QUINTIC)),
        Bad("servo blind", RejectCode.ECHO_STALE, servo(), replace(VIEW, state_age_ns=101 * MS)),
        Bad("servo other session", RejectCode.SESSION, servo(), replace(VIEW, session=8)),
        Bad("servo unarmed", RejectCode.MODE_ILLEGAL, servo(), linked),
        Bad("servo axis mask", RejectCode.AXIS_MASK, servo(axis_mask=1)),
        Bad("servo override", RejectCode.OVERRIDE, servo(speed_override=1.01)),
        Bad("servo number", RejectCode.TRAJ_ID, servo(traj_id=0)),
        Bad("servo fast", RejectCode.LIMIT_QD, servo(knots=(Knot(0, HERE, (0.50001, *ZEROS[1:])),))),
        Bad("servo far", RejectCode.IMPLIED_SPEED, servo(knots=(Knot(0, (0.3 + 0.12501, 0.2, *ZEROS[2:])),))),
        Bad("servo far down", RejectCode.IMPLIED_SPEED, servo(knots=(Knot(0, (0.3 - 0.12501, 0.2, *ZEROS[2:])),))),
        Bad("arm while running", RejectCode.MODE_ILLEGAL, arm, VIEW),
        Bad("arm blind", RejectCode.ECHO_STALE, arm, replace(linked, state_age_ns=101 * MS)),
        Bad("arm other session", RejectCode.SESSION, arm, replace(linked, session=8)),
        Bad("arm no session", RejectCode.SESSION, replace(arm, session=0), replace(linked, session=0)),
        Bad("arm old nonce", RejectCode.NONCE, replace(arm, arm_nonce=76), linked),
        Bad("arm no nonce", RejectCode.NONCE, replace(arm, arm_nonce=0), replace(linked, nonce=0)),
        Bad("reset without fault", RejectCode.MODE_ILLEGAL, Command(9, 5, 0, Mode.RESET), VIEW),
        Bad("blind", RejectCode.ECHO_STALE, trajectory(REST), replace(VIEW, state_age_ns=101 * MS)),
        Bad("state from the future", RejectCode.ECHO_STALE, trajectory(REST), replace(VIEW, state_age_ns=-1)),
        Bad("other session", RejectCode.SESSION, trajectory(REST), replace(VIEW, session=8)),
        Bad("no knots", RejectCode.VALUE, trajectory(())),
        Bad("seven knots", RejectCode.VALUE, trajectory(tuple(Knot((100 + 50 * i) * MS, HERE) for i in range(7)))),
        Bad("cubic", RejectCode.INTERP, replace(trajectory(REST), interp=Interp.CUBIC)),
        Bad("axis mask", RejectCode.AXIS_MASK, replace(trajectory(REST), axis_mask=7)),
        Bad("override high", RejectCode.OVERRIDE, replace(trajectory(REST), speed_override=1.01)),
        Bad("override low", RejectCode.OVERRIDE, replace(trajectory(REST), speed_override=-0.01)),
        Bad("override nan", RejectCode.OVERRIDE, replace(trajectory(REST), speed_override=float("nan"))),
        Bad("no number", RejectCode.TRAJ_ID, replace(trajectory(REST), traj_id=0)),
        Bad("late start", RejectCode.START, trajectory(tuple(replace(k, t_ns=k.t_ns + MS) for k in START), 0), HOLDING),
        Bad("start elsewhere", RejectCode.START, trajectory(moved, 0), HOLDING),
        Bad("start moving", RejectCode.START, trajectory(with_value(START, 0, 0, qd=2e-6), 0), HOLDING),
        Bad("start accelerating", RejectCode.START, trajectory(with_value(START, 0, 0, qdd=2e-6), 0), HOLDING),
        Bad("unknown knot before", RejectCode.KNOT_GAP, trajectory(REST), replace(VIEW, knot_before=None)),
        Bad(
            "end moving",
            RejectCode.END_NOT_AT_REST,
            trajectory(with_value(REST, 2, 0, qd=2e-6), flags=CommandFlag.LAST_IS_END),
        ),
        Bad(
            "end accelerating",
            RejectCode.END_NOT_AT_REST,
            trajectory(with_value(REST, 2, 1, qdd=-2e-6), flags=CommandFlag.LAST_IS_END),
        ),
        Bad("unused axis q", RejectCode.AXIS_MASK, trajectory(with_value(REST, 1, 2, q=1e-9))),
        Bad("unused axis qd", RejectCode.AXIS_MASK, trajectory(with_value(REST, 1, 7, qd=1e-9))),
        Bad("unused axis qdd", RejectCode.AXIS_MASK, trajectory(with_value(REST, 1, 7, qdd=1e-9))),
        Bad("close", RejectCode.KNOT_SPACING, trajectory(moving(0, dt_ns=5 * MS - 1))),
        Bad("far", RejectCode.KNOT_SPACING, trajectory(moving(0, dt_ns=200 * MS + 1))),
        Bad("backwards", RejectCode.KNOT_SPACING, trajectory(REST[::-1])),
        Bad(
            "step from the knot before",
            RejectCode.IMPLIED_SPEED,
            trajectory(REST),
            replace(VIEW, knot_before=Knot(50 * MS, (0.27, 0.2, *ZEROS[2:]))),
        ),
        Bad("step inside", RejectCode.IMPLIED_SPEED, trajectory(with_value(REST, 1, 1, q=0.2 + 0.0126))),
        Bad("kink", RejectCode.CONTINUITY, trajectory(with_value(REST, 1, 0, qd=0.3))),
        Bad("bend", RejectCode.CONTINUITY, trajectory(with_value(REST, 1, 0, q=0.31))),
    ]
    cases.append(hump())
    for state in PlcState:
        if state not in (PlcState.HOLD, PlcState.RUN):
            cases.append(
                Bad(
                    f"trajectory in {state.name}",
                    RejectCode.MODE_ILLEGAL,
                    trajectory(REST),
                    replace(VIEW, plc_state=state),
                )
            )
    for axis, limits in enumerate(TABLE.axes):
        for value in (limits.q_min - 1e-6, limits.q_max + 1e-6, float("nan")):
            there = tuple(value if i == axis else x for i, x in enumerate(HERE))
            knots = tuple(replace(k, q=there) for k in REST)
            cases.append(
                Bad(
                    f"{limits.name} at {value}",
                    RejectCode.LIMIT_Q,
                    trajectory(knots),
                    replace(VIEW, knot_before=Knot(50 * MS, there)),
                )
            )
        for sign in (-1, 1):
            fast = moving(axis, qd=sign * limits.qd_max * 1.00001)
            cases.append(
                Bad(
                    f"{limits.name} fast {sign}",
                    RejectCode.LIMIT_QD,
                    trajectory(fast),
                    replace(VIEW, knot_before=before(fast, axis)),
                )
            )
            hard = moving(axis, qdd=sign * limits.qdd_max * 1.00001)
            cases.append(
                Bad(
                    f"{limits.name} hard {sign}",
                    RejectCode.LIMIT_QDD,
                    trajectory(hard),
                    replace(VIEW, knot_before=before(hard, axis)),
                )
            )
    return cases


BAD = bad_cases()


@pytest.mark.parametrize("case", BAD, ids=lambda case: case.name)
def test_what_is_not_safe_becomes_a_stop_with_its_reason(case: Bad) -> None:
    verdict = gate(case.command, case.view, TABLE)
    assert case.code in {refusal.code for refusal in verdict.refusals}
    assert verdict.command_to_send.mode is Mode.STOP
    assert verdict.command_to_send.knots == ()
    assert (verdict.command_to_send.session, verdict.command_to_send.seq) == (case.command.session, case.command.seq)
    for refusal in verdict.refusals:
        assert refusal.subject
        assert refusal.remedy
        assert refusal.remedy in refusal.as_line


@pytest.mark.parametrize("factor", [1 - 1e-5, 1.0])
def test_up_to_the_limits_everything_passes(factor: float) -> None:
    for axis, limits in enumerate(TABLE.axes):
        for sign in (-1, 1):
            fast = moving(axis, qd=sign * limits.qd_max * factor)
            assert gate(trajectory(fast), replace(VIEW, knot_before=before(fast, axis)), TABLE).refusals == ()
            hard = moving(axis, qdd=sign * limits.qdd_max * factor)
            assert gate(trajectory(hard), replace(VIEW, knot_before=before(hard, axis)), TABLE).refusals == ()
        for value in (limits.q_min, limits.q_max):
            there = tuple(value * factor if i == axis else x for i, x in enumerate(HERE))
            knots = tuple(replace(k, q=there) for k in REST)
            view = replace(VIEW, knot_before=Knot(50 * MS, there))
            assert gate(trajectory(knots), view, TABLE).refusals == ()
    for dt_ns in (5 * MS, 200 * MS):
        assert gate(trajectory(moving(0, dt_ns=dt_ns)), VIEW, TABLE).refusals == ()
    assert gate(trajectory(REST), replace(VIEW, state_age_ns=100 * MS), TABLE).refusals == ()
    near = tuple(replace(k, q=(0.3 + 0.99e-5, *k.q[1:])) for k in START)
    assert gate(trajectory(near, 0), HOLDING, TABLE).refusals == ()


def test_a_whole_trajectory_is_checked_before_its_start() -> None:
    assert check_trajectory(START, HERE, TABLE) == ()
    assert check_trajectory(START[:1], HERE, TABLE)[0].code is RejectCode.VALUE
    assert check_trajectory(START, ZEROS, TABLE)[0].code is RejectCode.START
    assert check_trajectory(with_value(START, 2, 0, qd=0.1), HERE, TABLE)[-1].code is RejectCode.END_NOT_AT_REST
    assert {r.code for r in check_trajectory(with_value(START, 1, 0, q=9.0), HERE, TABLE)} >= {RejectCode.LIMIT_Q}


# --- the gate mutated: each check taken out alone must let a bad case through -------------------------------------


class _Disable(ast.NodeTransformer):
    """Takes out the n-th check: an `if` that guards a refusal becomes never, a `yield` of refusals disappears."""

    def __init__(self, n: int) -> None:
        self.left = n
        self.what = ""

    def _hit(self, node: ast.AST) -> bool:
        self.left -= 1
        if self.left == -1:
            self.what = ast.unparse(node).splitlines()[0]
        return self.left == -1

    def visit_If(self, node: ast.If) -> ast.AST:
        guards = any(isinstance(inner, ast.Yield | ast.YieldFrom) for inner in ast.walk(node))
        if guards and self._hit(node):
            node.test = ast.Constant(False)
        self.generic_visit(node)
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        if self._hit(node):
            return node.values[-1]
        if self._hit(node):
            return node.values[0]
        self.generic_visit(node)
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        """A chain a <= b <= c loses its lower or its upper end."""
        if len(node.ops) == 2:
            if self._hit(node):
                return ast.Compare(node.comparators[0], node.ops[1:], node.comparators[1:])
            if self._hit(node):
                return ast.Compare(node.left, node.ops[:1], node.comparators[:1])
        return node

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        if isinstance(node.value, ast.YieldFrom) and self._hit(node):
            return ast.Pass()
        self.generic_visit(node)
        return node


SKIPPED_FUNCTIONS = {"gate", "check_trajectory"}  # the assembly; every line of it is covered by the tests above


def mutants() -> list[tuple[str, Callable[..., object]]]:
    source = inspect.getsource(gate_module)
    made = []
    for n in range(200):
        tree = ast.parse(source)
        mutator = _Disable(n)
        for function in tree.body:
            if isinstance(function, ast.FunctionDef) and function.name not in SKIPPED_FUNCTIONS:
                mutator.visit(function)
        if not mutator.what:
            break
        module = types.ModuleType("mutated_gate")
        module.__dict__["__name__"] = "protocol.gate"
        exec(compile(ast.fix_missing_locations(tree), "mutated_gate", "exec"), module.__dict__)
        made.append((mutator.what, module.gate))
    return made


def is_killed(mutant: Callable[..., object]) -> bool:
    for case in BAD:
        try:
            codes = {refusal.code for refusal in mutant(case.command, case.view, TABLE).refusals}  # type: ignore[attr-defined]
        except (AttributeError, TypeError, ZeroDivisionError, IndexError, OverflowError):
            return True  # it no longer works at all: the cases notice
        if case.code not in codes:
            return True
    return any(mutant(command, view, TABLE).refusals for _, command, view in GOOD)  # type: ignore[attr-defined]


def test_every_mutant_of_the_gate_is_noticed() -> None:
    made = mutants()
    assert len(made) >= 40
    survivors = [what for what, mutant in made if not is_killed(mutant)]
    assert survivors == []
