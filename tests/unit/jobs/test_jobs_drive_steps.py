"""Drives of several motions: what is refused before anything moves, at planning and again at the start."""

from dataclasses import replace

import numpy as np
import pytest
from test_jobs_plans import CHAIN, MACHINE, Q_START, World, context

from server.errors import JobFailedError, PlanRefusedError
from server.jobs.plans.drive_steps import (
    START_SHIFT_MAX_RAD,
    begin_drive,
    clearance_of,
    refuse_unsafe_reference,
    steps_hash,
    way_to,
)
from server.jobs.requests import Arm
from server.motion.contracts import JointTrajectory
from server.motion.identification_courses import Course, course_trajectory


def performed(plan, world):
    """Everything that a plan asked for, and its result."""
    requests, reply = [], None
    while True:
        try:
            request = plan.send(reply)
        except StopIteration as end:
            return requests, end.value
        requests.append(request)
        reply = world.perform(request)


def motion(size_rad=0.03, joint=6, start=Q_START, seconds=8.0) -> JointTrajectory:
    """One joint there and back, every 0.1 s."""
    t = np.arange(0.0, seconds + 0.05, 0.1)
    u = np.clip(np.minimum(t, t[-1] - t) / 2.0, 0.0, 1.0)
    q = np.tile(start, (len(t), 1))
    q[:, joint - 1] += size_rad * (10 * u**3 - 15 * u**4 + 6 * u**5) * np.sin(1.5 * t)
    return course_trajectory(Course(q, 0.1))


def towards(world, metres):
    """A wall that far in front of the tool."""
    T = world.tool()
    wall = T.copy()
    wall[:3, 3] -= metres * T[:3, 2]
    return wall


def test_the_wall_and_a_range_refuse():
    world, ctx = World(), context()
    refuse_unsafe_reference(ctx, motion(size_rad=0.05, joint=3))
    assert clearance_of(ctx, motion()) == np.inf
    ctx.knowledge.T_base_ooi = towards(world, 0.06)  # 60 mm away, 50 mm must stay
    with pytest.raises(JobFailedError, match="from the wall") as refused:
        refuse_unsafe_reference(ctx, motion(size_rad=0.05, joint=3))
    assert refused.value.code == "plan_wall"
    far = Q_START.copy()
    far[1] = MACHINE.joints[1].q_max_rad - 0.01
    with pytest.raises(JobFailedError, match="limit") as refused:
        refuse_unsafe_reference(context(), motion(size_rad=0.05, joint=2, start=far))
    assert refused.value.code == "plan_joint_limit"


def test_no_way_is_driven_to_where_the_reference_is():
    there = Q_START + np.deg2rad([2.0, 1.0, -1.0, 0.0, 0.0, 3.0])
    assert way_to(context(), Q_START, Q_START, "nowhere") == ()
    (step,) = way_to(context(), Q_START, there, "to where it begins")
    assert np.array_equal(step.trajectory.q[-1], there)
    assert steps_hash((step,)) == steps_hash((step,)) != steps_hash((replace(step, follow_up="look"),))


def test_a_wall_that_a_look_has_found_since_refuses_the_kept_drive():
    world, ctx = World(), context()
    ctx.knowledge.T_base_ooi = towards(world, 0.06)
    with pytest.raises(JobFailedError, match="from the wall") as refused:
        performed(begin_drive(ctx, [motion(size_rad=0.05, joint=3)], world.q_ref, "a drive"), world)
    assert (refused.value.code, world.moved) == ("plan_wall", 0)


def test_a_machine_that_has_moved_since_is_not_driven():
    world, ctx = World(), context()
    requests, _ = performed(begin_drive(ctx, [motion()], world.q_ref, "a drive"), world)
    assert sum(isinstance(request, Arm) for request in requests) == 1
    assert ctx.knowledge.q_start is not None
    world.q_ref = world.q_ref + 2.0 * START_SHIFT_MAX_RAD
    with pytest.raises(PlanRefusedError, match="moved by"):
        performed(begin_drive(ctx, [motion()], world.q_ref - 2.0 * START_SHIFT_MAX_RAD, "a drive"), world)
    assert (world.moved, CHAIN.n) == (0, 6)
