"""Orientation adjustment (section 3.1): turn the tool about its marker until its axes are the OOI's."""

from collections.abc import Generator

import numpy as np

from machine.poses import pose
from machine.rotations import Array
from server.calibration.reference import orientation_reference, orientation_reference_paper_axes
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.driving import drive_and_look
from server.jobs.requests import Progress, Request

ORIENTATION_ERROR_OK_DEG = 0.6  # below this a step costs time and brings nothing: the later moves correct it on the way


def orient(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, LookTaken]:
    """Orientation steps until good enough or out of steps. Returns the last look."""
    if ctx.knowledge.q_start is None:  # orienting by itself begins a run, as a move does
        ctx.knowledge.q_start = taken.reading.q_rad
    for step in range(1, ctx.settings.position.orientation_steps_max + 1):
        if taken.error is None or taken.error.rotation_deg < ORIENTATION_ERROR_OK_DEG:
            break
        yield Progress(
            "orient", step, ctx.settings.position.orientation_steps_max, "steps", "turning the tool to the OOI"
        )
        T_goal, purpose = orientation_goal(ctx, taken), f"orientation step {step}"
        taken = yield from drive_and_look(ctx, taken, T_goal, "orientation", step, purpose, 1)  # only the angle matters
        if ctx.method == "paper":
            break  # the paper turns once
    return taken


def orientation_goal(ctx: PlanContext, taken: LookTaken) -> Array:
    """T_base_tcp that turns the tool to the OOI about the tool marker, which stays where it is."""
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        raise JobFailedError("no poses in the look; look again", "look_rejected")
    T_base_tcp = ctx.tcp(taken.reading.q_rad)
    R_cam_tool, R_cam_ooi = look.T_cam_tool[:3, :3], look.T_cam_ooi[:3, :3]
    if ctx.method == "paper":
        # "camera axes = TCP axes": eq. 8 turns in camera axes, carried into ours by the nominal mount.
        R_tcp_cam = ctx.machine.T_tcp_cam_left[:3, :3]
        R_ref = orientation_reference_paper_axes(T_base_tcp[:3, :3], R_tcp_cam, R_cam_ooi, R_cam_tool)
    else:
        R_ref = orientation_reference(T_base_tcp[:3, :3], ctx.machine.T_tcp_tool[:3, :3], R_cam_tool, R_cam_ooi)
    p_tcp_tool = ctx.machine.T_tcp_tool[:3, 3]
    p_base_tool = T_base_tcp[:3, 3] + T_base_tcp[:3, :3] @ p_tcp_tool
    return pose(R_ref, np.asarray(p_base_tool - R_ref @ p_tcp_tool))
