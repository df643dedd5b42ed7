"""Step: how long and how far the machine still goes after STOP, QUICK_STOP and silence, at half and at full speed."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from machine.kinematics import tcp_pose
from machine.poses import pose
from machine.rotations import Array
from server.commissioning.contracts import Figure, ReportTable, StepResult, result_of_figures
from server.commissioning.moving import (
    NotReadyError,
    arm_if_needed,
    play_gently,
    read_machine,
    require_leave,
    wait_for_rest,
)
from server.commissioning.site import Site
from server.commissioning.stop_figures import StopFigures, stop_figures
from server.commissioning.stopping import (
    RAMP_SLACK_MS,
    EndedByItselfError,
    StopKind,
    by_itself,
    rest_figures,
    run_and_stop,
)
from server.link.errors import LinkError
from server.motion.contracts import JointTrajectory, PathPlan
from server.motion.point_to_point import plan_joint_move, plan_move
from server.motion.settings import PlanSettings

STOP_TIMES_STEP_NAME = "stop times"
STOP_TIMES_REMEDY = (
    "compare qdd_max in the machine file with what the machine can do; check the valve gains and the PLC task"
)
TRAVEL_MAX_MM = 80.0
TESTED_SPEED_SCALES = (0.5, 1.0)
TESTED_STOP_KINDS = (StopKind.STOP, StopKind.QUICK_STOP, StopKind.SILENCE)
TEST_LINE_LENGTHS_M = (0.30, 0.22, 0.16)
JOINT_SPANS_RAD = (0.30, 0.20, 0.12)
FAST_PLAN_SETTINGS = PlanSettings(limit_share=0.98)  # as fast as any motion that this machine will be sent
_HEADINGS = ("move", "speed %", "stop", "TCP mm/s", "begins ms", "ramp ms", "bound ms", "still ms", "TCP mm")
# away from what the tool looks at first, then across it
_DIRECTIONS_TCP = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))


@dataclass(frozen=True, slots=True)
class StopCase:
    """One move that is stopped: which joint turns (None: the tool goes straight), how fast, and what stops it."""

    joint_index: int | None
    speed_scale: float
    stop_kind: StopKind


def stop_cases(joints: int, each_joint: bool) -> Iterator[StopCase]:
    """The cases in order: the tool's straight move, then joint by joint where `each_joint` is set."""
    for joint in (None, *(range(joints) if each_joint else ())):
        for speed in TESTED_SPEED_SCALES:
            for kind in TESTED_STOP_KINDS:
                yield StopCase(joint, speed, kind)


async def stop_times(site: Site) -> StepResult:
    """Every case from the same place; the machine is taken back slowly after each."""
    text = "the tool will now move up to 0.3 m away from what it looks at, and is stopped on the way, several times"
    await require_leave(site, text)
    await arm_if_needed(site)
    home = (await wait_for_rest(site)).q_ref
    figures: list[Figure] = []
    rows: list[tuple[str, ...]] = []
    not_measured: list[str] = []
    for case in stop_cases(site.chain.n, site.options.each_joint):
        name = _case_name(site, case)
        try:
            stop = await _measure_stop(site, case, name)
        except EndedByItselfError as error:
            figures.append(by_itself(name, error))
        except (NotReadyError, LinkError, ValueError) as error:  # what was measured so far is kept
            not_measured.append(f"{name}: {error}")
        else:
            figures += [*rest_figures(name, case.stop_kind, stop), *tcp_travel_figures(name, stop)]
            rows.append(_stop_table_row(site, case, stop))
        try:
            await _take_home(site, home)
        except (NotReadyError, LinkError) as error:
            not_measured.append(f"after '{name}' the machine could not be moved back: {error}")
            break
    table = ReportTable(f"stops; ramp at most bound + {RAMP_SLACK_MS:.0f} ms", _HEADINGS, tuple(rows))
    summary = f"every ramp within |qd|/qdd_max, every travel below {TRAVEL_MAX_MM:.0f} mm, nothing resumed"
    return result_of_figures(STOP_TIMES_STEP_NAME, figures, summary, STOP_TIMES_REMEDY, not_measured, tables=(table,))


async def _measure_stop(site: Site, case: StopCase, name: str) -> StopFigures:
    trajectory = await _stop_test_trajectory(site, case)
    stopped = await run_and_stop(site, trajectory, case.stop_kind, name)
    return stop_figures(stopped.plc_samples, stopped.t_trigger_plc_ns, site.machine)


async def _take_home(site: Site, home: Array) -> None:
    await arm_if_needed(site)
    await wait_for_rest(site)
    if float(np.abs((await read_machine(site)).q_ref - home).max()) > 1e-6:
        played = await play_gently(site, home, "slowly back")
        if not played.motion_end.reached:
            raise NotReadyError(f"the way back ended early: {played.motion_end.reason}")
    await wait_for_rest(site)


async def _stop_test_trajectory(site: Site, case: StopCase) -> JointTrajectory:
    q_ref = (await read_machine(site)).q_ref
    settings = replace(FAST_PLAN_SETTINGS, speed_scale=case.speed_scale)
    plans = (
        _single_joint_moves(site, q_ref, case.joint_index, settings)
        if case.joint_index is not None
        else _tool_plans(site, q_ref, settings)
    )
    reason = ""
    for plan in plans:
        if plan.trajectory is not None:
            return plan.trajectory
        reason = reason or plan.reason
    raise NotReadyError(f"no move of the required length is possible from here: {reason}")


def _tool_plans(site: Site, q_ref: Array, settings: PlanSettings) -> Iterator[PathPlan]:
    """Straight moves of the tool, the longest and safest direction first."""
    T = tcp_pose(site.chain, q_ref)
    for length_m in TEST_LINE_LENGTHS_M:
        for direction in _DIRECTIONS_TCP:
            point = T[:3, 3] + length_m * (T[:3, :3] @ np.array(direction))
            yield plan_move(site.machine, q_ref, pose(T[:3, :3], point), settings)


def _single_joint_moves(site: Site, q_ref: Array, joint: int, settings: PlanSettings) -> Iterator[PathPlan]:
    """Moves of one joint, towards the middle of its range first."""
    limits = site.machine.joints[joint]
    inward = 1.0 if (limits.q_min_rad + limits.q_max_rad) / 2.0 >= q_ref[joint] else -1.0
    for span_rad in JOINT_SPANS_RAD:
        for sign in (inward, -inward):
            goal = q_ref.copy()
            goal[joint] += sign * span_rad
            yield plan_joint_move(site.machine, q_ref, goal, settings)


def tcp_travel_figures(name: str, stop: StopFigures) -> list[Figure]:
    """How far the tool still went, by the encoders."""
    return [Figure(f"{name}: TCP travel", stop.tcp_travel_mm, "mm", at_most=TRAVEL_MAX_MM)]


def _case_name(site: Site, case: StopCase) -> str:
    what = "tool" if case.joint_index is None else site.machine.joints[case.joint_index].name
    return f"{what} at {100 * case.speed_scale:.0f} %, {case.stop_kind.value}"


def _stop_table_row(site: Site, case: StopCase, stop: StopFigures) -> tuple[str, ...]:
    what = "tool" if case.joint_index is None else site.machine.joints[case.joint_index].name
    numbers = (
        stop.tcp_speed_mm_s,
        stop.reaction_ms,
        stop.ramp_ms,
        stop.ramp_bound_ms,
        stop.machine_still_ms,
        stop.tcp_travel_mm,
    )
    return (what, f"{100 * case.speed_scale:.0f}", case.stop_kind.value, *(f"{number:.0f}" for number in numbers))
