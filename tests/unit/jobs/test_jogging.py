"""The jog's plan against a stand-in world: one motion inside the limits, or a refusal before anything moves."""

import numpy as np
import pytest
from test_jobs_plans import CHAIN, World, context, run

from machine.kinematics import tcp_pose
from server.errors import JobFailedError
from server.jobs.plans.jogging import jog
from server.jobs.requests import Arm, Move, Settle
from server.motion.jog import TOOL_AXES


@pytest.mark.parametrize("axis", [*(f"joint_{n}" for n in range(1, 7)), *TOOL_AXES])
def test_a_jog_is_one_motion_and_the_world_follows_it(axis):
    world, ctx = World(), context()
    before = world.q.copy()
    run(jog(ctx, axis, 1), world)
    assert world.moved == 1
    assert (world.q >= CHAIN.q_min).all()
    assert (world.q <= CHAIN.q_max).all()
    moved = tcp_pose(CHAIN, before)[:3, :3].T @ (tcp_pose(CHAIN, world.q)[:3, 3] - tcp_pose(CHAIN, before)[:3, 3])
    if axis in ("x", "y", "z"):
        assert moved["xyz".index(axis)] > 0.1
    elif axis.startswith("joint_"):
        assert world.q[int(axis[-1]) - 1] > before[int(axis[-1]) - 1]


def test_it_settles_before_it_arms_and_arms_before_it_moves():
    plan, world, kinds, reply = jog(context(), "joint_2", 1), World(), [], None
    for _ in range(6):
        try:
            request = plan.send(reply)
        except StopIteration:
            break
        kinds.append(type(request))
        reply = world.perform(request)
    assert [kind for kind in kinds if kind in (Settle, Arm, Move)] == [Settle, Arm, Move, Settle]


def test_at_a_limit_nothing_is_armed_and_the_reason_names_the_joint():
    world, ctx = World(), context()
    world.q[1] = world.q_ref[1] = CHAIN.q_max[1]
    with pytest.raises(JobFailedError, match=ctx.machine.joints[1].name) as refused:
        run(jog(ctx, "joint_2", 1), world)
    assert refused.value.code == "plan_joint_limit"
    assert world.moved == 0


def test_what_will_end_it_is_reported_before_it_moves():
    world, ctx = World(), context()
    world.q[1] = world.q_ref[1] = CHAIN.q_max[1] - np.deg2rad(3.0)
    result, story = run(jog(ctx, "joint_2", 1), world)
    assert story[0].name == "jog_limit"
    assert ctx.machine.joints[1].name in story[0].text
    assert ctx.machine.joints[1].name in result
    assert world.q[1] <= CHAIN.q_max[1]
