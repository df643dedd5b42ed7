"""Retract from the wall, return to where the run began, park."""

from collections.abc import Generator

import numpy as np

from machine.description import Machine
from machine.rotations import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.plans.driving import drive_and_correct, execute_plan
from server.jobs.plans.planning import onto_reference, plan_settings, plan_to
from server.jobs.requests import MachineReading, Request, Settle, expect_reply
from server.motion.approach import offset_goal
from server.motion.point_to_point import plan_joint_move


def retract(ctx: PlanContext, distance_mm: float) -> Generator[Request, object, str]:
    """Back away from the wall along the tool's axis (z_tcp points back)."""
    reading = expect_reply((yield Settle()), MachineReading)
    T_goal = offset_goal(ctx.tcp(reading.q_rad), np.array([0.0, 0.0, distance_mm * 1e-3]))
    plan = plan_to(ctx, reading, T_goal, one_sided=False)
    yield from execute_plan(ctx, plan, "retract")
    yield Settle()
    return f"retracted by {distance_mm:.0f} mm"


def return_to_start(ctx: PlanContext) -> Generator[Request, object, str]:
    """Back along a joint path to where the last run began."""
    if ctx.knowledge.q_start is None:
        raise JobFailedError("no run has begun yet, so there is no start to return to", "no_start")
    yield from _to_joints(ctx, ctx.knowledge.q_start, "return to start")
    return "at the start of the run"


def park(ctx: PlanContext) -> Generator[Request, object, str]:
    """Retract by 300 mm if a wall is known, then fold to the machine file's park posture.

    Raises: JobFailedError when the file has none; nothing moves then.
    """
    why_not = why_no_park(ctx.machine)
    if why_not:
        raise JobFailedError(f"park: {why_not}", "no_park_posture")
    if ctx.wall is not None:
        yield from retract(ctx, 300.0)
    reading = expect_reply((yield Settle()), MachineReading)
    parked = zip(ctx.machine.joints, reading.q_rad, strict=True)
    q_park = np.array([q if joint.park_rad is None else joint.park_rad for joint, q in parked])
    yield from _to_joints(ctx, q_park, "park")
    return "parked"


def why_no_park(machine: Machine) -> str:
    """Why a machine cannot be parked; empty when it can."""
    if any(joint.park_rad is not None for joint in machine.joints):
        return ""
    return f"the machine file of {machine.name} names no park posture: give park_deg to the joints that fold"


def _to_joints(ctx: PlanContext, q_goal: Array, purpose: str) -> Generator[Request, object, None]:
    reading = expect_reply((yield Settle()), MachineReading)
    plan = plan_joint_move(ctx.machine, reading.q_rad, q_goal, plan_settings(ctx), ctx.wall)
    yield from drive_and_correct(ctx, onto_reference(ctx, plan, reading), purpose)
