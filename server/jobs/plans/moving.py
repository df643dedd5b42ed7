"""Preview and execute one look-then-move."""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from machine.rotations import Array
from server.calibration.joint_estimate import JointEstimate
from server.calibration.joint_goal import joints_for_goal
from server.calibration.nuisances import largest_in_words
from server.calibration.reference import position_reference_paper, predicted_error_covariance
from server.errors import JobFailedError, PlanRefusedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken, PreviewedPlan, plan_hash
from server.jobs.plans.diagnosed import compared_move, goal_from_look
from server.jobs.plans.driving import TRIMS_MAX, drive_and_correct
from server.jobs.plans.freshness import require_fresh
from server.jobs.plans.learning import joint_estimate
from server.jobs.plans.living import calibration_validity, note_map, require_valid, validity_at
from server.jobs.plans.looking import good_look, mount_rotation
from server.jobs.plans.planning import plan_to
from server.jobs.plans.seeing import common_of
from server.jobs.plans.unmoved import require_unmoved
from server.jobs.records import MoveRecord
from server.jobs.requests import MachineReading, Progress, ReadMachine, Record, Request, expect_reply
from server.motion.contracts import PlanStatus

Sigmas = tuple[float, float, float]

LOOK_ONLY_CAUTION = "the move would be based on the look alone, without a learnt map; calibrate"
LONG_MOVE_MIN_M = 0.25  # after a longer move the camera has more to correct than the encoders can show


def preview(ctx: PlanContext, taken: LookTaken, t_now_ns: int) -> PreviewedPlan:
    """Plan one move from a look: nothing moves.

    Raises: JobFailedError with the planner's reason when there is no admissible path.
    """
    if taken.error is None:
        raise JobFailedError(f"no usable look: {taken.record.reason}; look again", "no_look")
    require_valid(calibration_validity(ctx, taken.reading), "preview")
    goal = move_goal(ctx, taken)
    T_goal = goal.T_base_tcp
    plan = plan_to(ctx, taken.reading, T_goal, q_goal=goal.q_rad)
    if plan.status is not PlanStatus.OK:
        raise JobFailedError(f"preview: {plan.reason}", f"plan_{plan.status.value}")
    at_goal = validity_at(ctx, taken.reading, plan.q_end, T_goal)
    if not at_goal.ok:
        raise JobFailedError(
            f"preview: at the goal {at_goal.reason.split(';')[0]}: use Position, which comes nearer first, or move "
            "nearer and calibrate there",
            f"calibration_{at_goal.status.value}",
        )
    previewed = PreviewedPlan(
        plan=plan,
        plan_hash=plan_hash(plan),
        q_ref_start=taken.reading.q_ref_rad,
        q_look=taken.reading.q_rad,
        q_goal=plan.q_end,
        T_base_tcp_goal=T_goal,
        before=taken.error,
        predicted_sigma_mm=goal.sigma_mm,
        largest_source=goal.largest_source,
        t_made_ns=t_now_ns,
        expires_ns=t_now_ns + int(ctx.settings.position.plan_expires_s * 1e9),
    )
    ctx.knowledge.previewed_plan = previewed
    return previewed


@dataclass(frozen=True, slots=True)
class MoveGoal:
    """T_base_tcp to plan for, one sigma of x, y, z after the move [mm], OOI axes, and the largest source of it.

    `q_rad`: the joints there (n,), where the joint estimate has found them.
    """

    T_base_tcp: Array
    sigma_mm: Sigmas
    largest_source: str = ""
    q_rad: Array | None = None


def move_goal(ctx: PlanContext, taken: LookTaken) -> MoveGoal:
    """The goal by the method, and what is predicted of the error there.

    Ours: from the joint estimate once a path was driven, else a step from the look; the paper's: eq. 20-22 with held
    orientation.
    Raises: JobFailedError when the joint estimate's goal cannot be reached.
    """
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        raise JobFailedError("no poses in the look; look again", "look_rejected")
    R_tcp_cam = mount_rotation(ctx, taken)
    if ctx.method == "paper":
        b_m = ctx.settings.position.stand_off_mm * 1e-3
        T_base_tcp = ctx.tcp(taken.reading.q_rad)
        R_base_cam = T_base_tcp[:3, :3] @ R_tcp_cam
        T_goal = position_reference_paper(T_base_tcp, R_base_cam, look.T_cam_tool[:3, 3], look.T_cam_ooi[:3, 3], b_m)
        return MoveGoal(T_goal, predicted_sigma_mm(ctx, taken))
    estimate = joint_estimate(ctx) if ctx.settings.position.local_map == "learnt" else None
    if estimate is not None and estimate.state is not None:
        note_map(ctx, estimate)
        return _joint_goal(ctx, estimate, taken.reading.q_rad)
    T_goal = goal_from_look(ctx, taken.reading.q_rad, R_tcp_cam, look.T_cam_tool, look.T_cam_ooi)
    # what contradicts the learnt map contradicts the step from the look as much
    wider = 1.0 if estimate is None or not np.isfinite(estimate.misfit) else max(1.0, estimate.misfit) ** 0.5
    x, y, z = predicted_sigma_mm(ctx, taken)
    return MoveGoal(T_goal, (wider * x, wider * y, wider * z), LOOK_ONLY_CAUTION)


def map_refused(ctx: PlanContext) -> str:
    """Why the last goal is by the look alone although a path was driven; empty where it is not."""
    known = ctx.knowledge.joint_estimate
    if ctx.method == "paper" or ctx.settings.position.local_map != "learnt" or known is None or known.state is not None:
        return ""
    return known.reason


def _joint_goal(ctx: PlanContext, estimate: JointEstimate, q_rad: Array) -> MoveGoal:
    from_below = np.ones(ctx.chain.n)  # as every approach ends
    goal = joints_for_goal(ctx.chain, estimate, q_rad, ctx.T_ooi_goal, side=from_below)
    if goal.T_base_tcp is None or goal.covariance is None:
        raise JobFailedError(f"preview: {goal.reason}", "plan_out_of_reach")
    x, y, z = np.sqrt(np.diag(goal.covariance)[3:]) * 1e3
    worst = int(np.argmax((x, y, z)))
    largest = largest_in_words(goal.contributions, worst)
    return MoveGoal(goal.T_base_tcp, (float(x), float(y), float(z)), largest, goal.q)


def predicted_sigma_mm(ctx: PlanContext, taken: LookTaken) -> Sigmas:
    """One sigma of the error after the move, in OOI axes [mm]: the look's own and the rotation's times the distance."""
    mount = ctx.knowledge.mount_rotation_estimate
    sigma_rad = np.deg2rad(ctx.settings.position.sigma_tool_mount_deg)
    rotation = mount.covariance if mount is not None and mount.covariance is not None else np.eye(3) * sigma_rad**2
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None or look.tool_covariance is None or look.ooi_covariance is None:
        raise JobFailedError("no poses in the look; look again", "look_rejected")
    covariance = predicted_error_covariance(
        rotation,
        mount_rotation(ctx, taken),
        look.T_cam_tool,
        look.T_cam_ooi,
        ctx.T_ooi_goal,
        look.tool_covariance,
        look.ooi_covariance,
        common_of(ctx, look.T_cam_tool, look.T_cam_ooi),
    )
    sigma_mm = np.sqrt(np.diag(covariance)) * 1e3
    return float(sigma_mm[0]), float(sigma_mm[1]), float(sigma_mm[2])


def check_executable(previewed: PreviewedPlan | None, wanted_hash: str, t_now_ns: int) -> PreviewedPlan:
    """The previewed plan, if it is the one named and still fresh.

    Raises: PlanRefusedError saying which of the two it is not.
    """
    if previewed is None:
        raise PlanRefusedError("no plan was previewed since the last look or move; preview first")
    if previewed.plan_hash != wanted_hash:
        raise PlanRefusedError(f"plan {wanted_hash} is not the previewed one ({previewed.plan_hash}); preview again")
    require_fresh(previewed.plan_hash, previewed.t_made_ns, previewed.expires_ns, t_now_ns, "look and preview again")
    return previewed


def execute(ctx: PlanContext, previewed: PreviewedPlan, number: int) -> Generator[Request, object, LookTaken]:
    """Run a previewed plan, rest, trim, look again. Returns the look after the move.

    Raises: PlanRefusedError when the machine moved since the look or the preview; nothing moves then.
    """
    ctx.knowledge.previewed_plan = None  # a plan fires once
    reading = expect_reply((yield ReadMachine()), MachineReading)
    require_unmoved(ctx.machine, reading, previewed)
    require_valid(calibration_validity(ctx, reading), f"move {number}")
    if ctx.knowledge.q_start is None:
        ctx.knowledge.q_start = reading.q_rad
    yield Progress("execute", number, ctx.settings.position.moves_max, "moves", f"move {number}")
    before = ctx.knowledge.last_look
    far = previewed.plan.length_m > LONG_MOVE_MIN_M
    trims = yield from drive_and_correct(ctx, previewed.plan, f"move {number}", trims_max=1 if far else TRIMS_MAX)
    taken = yield from good_look(ctx)
    record = MoveRecord(
        number=number,
        kind="move",
        before=previewed.before,
        after=taken.error,
        predicted_sigma_mm=previewed.predicted_sigma_mm,
        length_mm=previewed.plan.length_m * 1e3,
        duration_s=previewed.plan.duration_s,
        trims=trims,
        t_rest_plc_ns=taken.record.t_plc_ns,
    )
    ctx.knowledge.moves.append(record)
    yield Record(record)
    compared = None if before is None else compared_move(ctx, number, before, taken)
    if compared is not None:
        ctx.knowledge.compared_moves.append(compared)
        yield Record(compared)
    return taken
