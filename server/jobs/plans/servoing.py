"""Closed-loop visual control, "looking and moving": slow, short, and only while every pair is good.

Each pair, joined with the encoders at its exposure, places the goal again; the tail of the running path is replaced so
that it ends there. The first pair that is missing, unfit or off stops the motion.
"""

from collections.abc import Callable, Generator
from dataclasses import replace

import numpy as np

from machine.rotations import Array
from recording.clock import mono_ns
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.living import calibration_validity, require_valid
from server.jobs.plans.looking import good_look
from server.jobs.plans.pair_gate import PairGate
from server.jobs.plans.steering_path import (
    SteeredPath,
    corrected_tail,
    goal_of,
    joints_near,
    next_pair_request,
    note_tail,
    off_goal,
    path_onto_reference,
)
from server.jobs.plans.tolerance import error_of, is_look_inside_tolerance
from server.jobs.records import ErrorMm, MoveRecord, ServoResult
from server.jobs.requests import (
    Arm,
    EndMove,
    MachineReading,
    PairSeen,
    Progress,
    ReadMachine,
    Record,
    Request,
    Settle,
    StartMove,
    StopMove,
    expect_reply,
)
from server.motion.approach import play_of
from server.motion.closed_loop import at_rest, with_start
from server.motion.contracts import JointTrajectory
from server.motion.lost_motion import last_direction, updated_stall
from server.motion.refusal import Refusal
from server.motion.seen_goal import SeenGoal

PAIR_TIMEOUT_AT_REST_S = 1.0  # at rest, for a pair after one that was late or unfit
LOOK_LOST_ERROR_CODE = "servo_look_lost"


def servo(ctx: PlanContext, clock_ns: Callable[[], int] = mono_ns) -> Generator[Request, object, ServoResult]:
    """From near the target into the tolerance while looking.

    Raises: JobFailedError: switched off, not calibrated, too far, vision not reliable, or a pair was lost on the way.
    """
    _require_permitted(ctx)
    started_ns = clock_ns()
    taken = first = yield from good_look(ctx)
    pairs = corrections = passes = 0
    while not is_look_inside_tolerance(ctx, taken) and passes < ctx.settings.closed_loop.passes_max:
        passes += 1
        require_valid(
            calibration_validity(ctx, taken.reading), "closed loop"
        )  # each look may show that the camera has slipped
        yield from _wait_for_reliable_pairs(ctx)
        before = error_of(taken)
        steered = yield from _one_pass(ctx, taken, passes)
        taken = yield from good_look(ctx)
        yield Record(_record_move(ctx, passes, before, taken, steered.current_trajectory))
        pairs, corrections = pairs + steered.n_pairs, corrections + steered.n_corrections
    return _servo_result(ctx, first, taken, passes, pairs, corrections, (clock_ns() - started_ns) * 1e-9)


def _require_permitted(ctx: PlanContext) -> None:
    if not ctx.settings.position.closed_loop:
        raise JobFailedError(
            "closed-loop control is switched off; set [position] closed_loop = true in the settings", "closed_loop_off"
        )
    if ctx.knowledge.mount_rotation_estimate is None:
        raise JobFailedError("closed-loop control needs a local calibration; calibrate first", "not_calibrated")


def _wait_for_reliable_pairs(ctx: PlanContext) -> Generator[Request, object, None]:
    """Good pairs in a row, at rest, before anything moves by them."""
    wanted, tries = ctx.settings.closed_loop.pairs_in_a_row, 0
    gate, in_a_row, number, fault = PairGate(ctx), 0, 0, ""
    yield Progress("servo", 0.0, wanted, "pairs", f"waiting for {wanted} good pairs in a row")
    while in_a_row < wanted:
        if tries >= 3 * wanted:
            raise JobFailedError(f"vision is not reliable enough for closed-loop motion: {fault}", "vision_unreliable")
        asked = next_pair_request(ctx, number)
        seen = expect_reply(
            (yield asked if in_a_row else replace(asked, silence_max_s=PAIR_TIMEOUT_AT_REST_S)), PairSeen
        )
        late, number = seen.number == number, seen.number
        tries += 1
        fault = gate.fault(seen) or fault
        in_a_row = 0 if late or gate.fault(seen) else in_a_row + 1


def _one_pass(ctx: PlanContext, taken: LookTaken, number: int) -> Generator[Request, object, SteeredPath]:
    """To just before the goal, then in from below, corrected on the way; the joints' rest shows their stall.

    The last leg turns every joint forward by more than its play and stiction, as every approach does: a shorter one
    would end wherever the dead bands let it.
    """
    reading = expect_reply((yield Settle()), MachineReading)
    T_goal = _goal_at_rest(ctx, taken, reading)
    play_rad = play_of(ctx.chain.n)
    goal = SeenGoal(T_goal)
    yield Arm()
    q_before = joints_near(ctx, T_goal, reading.q_rad) - play_rad
    before = _plan_steered_path(ctx, goal, reading, q_before, corrects=False)
    yield from _drive_steered_path(ctx, before, f"closed loop, pass {number}: to just before the goal")
    reading = expect_reply((yield ReadMachine()), MachineReading)
    steered = _plan_steered_path(ctx, goal, reading, joints_near(ctx, goal.pose, reading.q_rad), corrects=True)
    yield from _drive_steered_path(ctx, steered, f"closed loop, pass {number}: in")
    rested = expect_reply((yield Settle()), MachineReading)
    direction = last_direction(steered.current_trajectory)
    ctx.knowledge.stall_rad, _ = updated_stall(ctx.stall, rested.q_ref_rad, rested.q_rad, direction, play_rad)
    steered.n_pairs += before.n_pairs
    return steered


def _goal_at_rest(ctx: PlanContext, taken: LookTaken, reading: MachineReading) -> Array:
    """T_base_tcp of the goal by the look at rest, if it is near enough to steer there."""
    distance_mm, limit_mm = error_of(taken).distance_mm, ctx.settings.closed_loop.distance_max_mm
    if distance_mm > limit_mm:
        raise JobFailedError(
            f"the goal is {distance_mm:.0f} mm away (closed loop: at most {limit_mm:.0f} mm); move nearer first",
            "servo_too_far",
        )
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        raise JobFailedError("no poses in the look; look again", "look_rejected")
    return goal_of(ctx, taken, reading.q_rad, look.T_cam_tool, look.T_cam_ooi)


def _plan_steered_path(
    ctx: PlanContext, goal: SeenGoal, reading: MachineReading, q_goal: Array, corrects: bool
) -> SteeredPath:
    start = at_rest(reading.q_ref_rad)
    tail = path_onto_reference(ctx, start, reading, q_goal, 1.0)
    if isinstance(tail, Refusal):
        raise JobFailedError(f"closed loop: {tail.reason}", f"plan_{tail.status.value}")
    return SteeredPath(goal, goal.pose, with_start(tail, start), reading, corrects)


def _drive_steered_path(ctx: PlanContext, steered: SteeredPath, purpose: str) -> Generator[Request, object, None]:
    yield Progress("servo", 0.0, steered.current_trajectory.duration_s, "s", purpose)
    yield StartMove(steered.current_trajectory, purpose)
    yield from _process_pairs_until_end(ctx, steered)
    yield EndMove()


def _process_pairs_until_end(ctx: PlanContext, steered: SteeredPath) -> Generator[Request, object, None]:
    """Pair by pair until the path is at its end; the first fault stops the motion and the job."""
    gate, number = PairGate(ctx), 0
    while True:
        seen = expect_reply((yield next_pair_request(ctx, number)), PairSeen)
        if seen.motion_ended:
            return
        number = seen.number
        fault = gate.fault(seen) or off_goal(ctx, steered, seen)
        if fault:
            text = f"closed loop stopped at the first invalid look: {fault}"
            yield StopMove(text)
            raise JobFailedError(f"{text}; clear the view, then look again", LOOK_LOST_ERROR_CODE)
        note_tail(steered, seen)
        correction = corrected_tail(ctx, steered, seen)
        if correction is not None:
            yield correction


def _record_move(ctx: PlanContext, number: int, before: ErrorMm, taken: LookTaken, path: JointTrajectory) -> MoveRecord:
    T = ctx.tcp(path.q[0]), ctx.tcp(path.q[-1])
    record = MoveRecord(
        number=number,
        kind="move",
        before=before,
        after=taken.error,
        predicted_sigma_mm=(0.0, 0.0, 0.0),  # nothing is predicted: the loop is closed on what is seen
        length_mm=1e3 * float(np.linalg.norm(T[1][:3, 3] - T[0][:3, 3])),
        duration_s=path.duration_s,
        trims=0,
        t_rest_plc_ns=taken.record.t_plc_ns,
    )
    ctx.knowledge.moves.append(record)
    return record


def _servo_result(
    ctx: PlanContext, first: LookTaken, last: LookTaken, passes: int, pairs: int, corrections: int, duration_s: float
) -> ServoResult:
    goal, reached = ctx.settings.position, is_look_inside_tolerance(ctx, last)
    state = "inside" if reached else "not inside"
    return ServoResult(
        reached=reached,
        reason=f"{state} +-{goal.tolerance_mm:g} mm and {goal.tolerance_deg:g} deg after {passes} passes while looking",
        start=error_of(first),
        end=error_of(last),
        moves=tuple(ctx.knowledge.moves[-passes:]) if passes else (),
        passes=passes,
        pairs=pairs,
        corrections=corrections,
        t_start_plc_ns=first.record.t_plc_ns,
        duration_s=round(duration_s, 2),
    )
