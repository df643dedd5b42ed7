"""The reach preview says before a job what the job's planner would say, and leaves nothing behind."""

import numpy as np
import pytest
from test_jobs_plans import World, context, run

from machine.poses import inverse_pose, pose
from server.errors import JobFailedError
from server.jobs.plans.looking import good_look
from server.jobs.plans.moving import preview
from server.jobs.plans.positioning import position
from server.jobs.plans.reach import reach_preview
from server.jobs.requests import Settle
from server.targets.contracts import AnchoredTarget, Landmarks, PatchStatus, SurfacePatch
from server.vision.contracts import ObjectPose, PoseStatus

CERTAIN = np.diag([1e-6] * 3 + [1e-8] * 3)


def target_at(T_cam_target: np.ndarray) -> AnchoredTarget:
    none, image = np.zeros((0, 2)), np.zeros((72, 128), np.uint8)
    marks = Landmarks(none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 2, 3)))
    patch = SurfacePatch(
        PatchStatus.OK, "", (64.0, 36.0), T_cam_target, CERTAIN, none, np.zeros((0, 3)), 0.06, "plane", 60, 0.03
    )
    return AnchoredTarget(1, patch, T_cam_target, CERTAIN, 0.0, image, image, marks, marks)


def previewed(world: World, ctx, T_base_ooi: np.ndarray):
    """The preview of an object at T_base_ooi, seen by the world's true camera."""
    T_base_cam = world.tool() @ inverse_pose(ctx.machine.T_tcp_tool) @ world.T_tcp_cam
    T_cam_tool, T_cam_target = inverse_pose(T_base_cam) @ world.tool(), inverse_pose(T_base_cam) @ T_base_ooi
    tool = ObjectPose("tool", PoseStatus.OK, "", T_cam_tool, CERTAIN, (), 0.1, float("inf"))
    return reach_preview(ctx, world.perform(Settle()), tool, target_at(T_cam_target), T_cam_target)


def test_what_is_previewed_as_reachable_is_reached_and_nothing_is_kept():
    world, ctx = World(), context()
    assert previewed(world, ctx, world.T_base_ooi).status == "reachable"
    known = ctx.knowledge
    assert (known.target, known.last_look, known.T_base_ooi, known.kept_calibration, known.mount_rotation_estimate) == (
        None,
    ) * 5
    assert world.moved == 0
    result, _ = run(position(ctx, recalibrate=True, clock_ns=lambda: world.t_ns), world)
    assert result.reached


def test_a_goal_farther_than_a_calibration_holds_is_approached_first():
    world, ctx = World(), context()
    world.T_base_ooi = world.T_base_ooi @ pose(np.eye(3), np.array([1.3, 0.0, 0.0]))
    assert previewed(world, ctx, world.T_base_ooi).status == "reachable"
    result, _ = run(position(ctx, recalibrate=True, clock_ns=lambda: world.t_ns), world)
    assert result.reached
    near = next(move for move in result.moves if move.kind == "approach")
    assert near.after is not None
    assert near.after.distance_mm < 1e3 * ctx.settings.calibration.expiry().radius_m < near.before.distance_mm
    assert "approach" in dict(result.seconds_by_step)


def test_a_kept_calibration_that_does_not_hold_at_the_goal_is_made_again_nearer():
    world, ctx = World(), context()
    run(position(ctx, recalibrate=True, clock_ns=lambda: world.t_ns), world)
    made = ctx.knowledge.kept_calibration
    world.T_base_ooi = world.T_base_ooi @ pose(np.eye(3), np.array([1.2, 0.0, 0.0]))
    result, story = run(position(ctx, recalibrate=False, clock_ns=lambda: world.t_ns), world)
    assert result.reached
    assert any(move.kind == "approach" for move in result.moves)
    assert ctx.knowledge.kept_calibration is not made
    assert any("calibrating again" in getattr(item, "text", "") for item in story)


def test_a_preview_too_far_from_the_calibration_names_the_job_that_comes_nearer():
    world, ctx = World(), context()
    run(position(ctx, recalibrate=True, clock_ns=lambda: world.t_ns), world)
    world.T_base_ooi = world.T_base_ooi @ pose(np.eye(3), np.array([1.2, 0.0, 0.0]))
    taken, _ = run(good_look(ctx), world)
    with pytest.raises(JobFailedError, match=r"limit 1\.00 m\): use Position, which comes nearer first"):
        preview(ctx, taken, 0)


def test_a_place_that_no_job_could_reach_is_refused_with_the_reason():
    world, ctx = World(), context()
    found = previewed(world, ctx, world.T_base_ooi @ pose(np.eye(3), np.array([0.0, 0.0, -6.0])))
    assert found.status == "refused"
    assert "reaches at most" in found.reason or "m away" in found.reason


def test_without_the_tool_in_view_the_reach_is_unknown():
    world, ctx = World(), context()
    tool = ObjectPose("tool", PoseStatus.NOT_SEEN, "covered", None, None, (), float("nan"), float("inf"))
    found = reach_preview(ctx, world.perform(Settle()), tool, target_at(np.eye(4)), np.eye(4))
    assert found.status == "unknown"
    assert "covered" in found.reason
