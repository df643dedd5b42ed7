"""Compile what a job will need before the server says that it is ready: a job must not wait seconds for a compiler."""

import asyncio
import contextlib
import logging
import os
import sys
import threading
from typing import NoReturn

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.kinematics import tcp_pose, tcp_poses
from machine.poses import inverse_pose, pose
from machine.rotations import Array
from server.calibration.contracts import CameraTrack, EncoderTrack
from server.calibration.kinematic_errors import error_model, tcp_poses_with_errors
from server.calibration.trajectory_matching import estimate_camera_rotation, prior_from_tool_marker
from server.motion.approach import plan_approach
from server.motion.calibration_paths import plan_calibration_path
from server.motion.contracts import sample_trajectory
from server.motion.lost_motion import first_stall, onto_reference, plan_trim
from server.motion.settings import DEFAULT_PLAN_SETTINGS


async def warmed_up(machine: Machine, chain: Chain) -> None:
    """`warm_up` outside the event loop. Cancelled, it returns immediately: nothing can interrupt a compiler, so its
    thread is left behind, and `exit_process` ends the process with it.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[None] = loop.create_future()

    def settle(error: BaseException | None) -> None:
        if not done.done():
            done.set_result(None) if error is None else done.set_exception(error)

    def compile_all() -> None:
        error = None
        try:
            warm_up(machine, chain)
        except BaseException as found:
            error = found
        with contextlib.suppress(RuntimeError):  # the loop is closed: the start was given up
            loop.call_soon_threadsafe(settle, error)

    threading.Thread(target=compile_all, name="compiler", daemon=True).start()
    await done


def exit_process(code: int) -> NoReturn:
    """End this process, when all that it opened is closed. Python itself would wait for a thread that compiles, and
    spend seconds on collecting a quarter of a million objects.
    """
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def warm_up(machine: Machine, chain: Chain) -> None:
    """Plan, match and trim once on the nominal machine, in the middle of its ranges; the results are thrown away."""
    q = _nonsingular_posture(chain)
    T = tcp_pose(chain, q)
    plan_approach(machine, q, pose(T[:3, :3], T[:3, 3] + 0.05), DEFAULT_PLAN_SETTINGS)
    stall = first_stall(machine)
    plan_trim(machine, q, q, q + 1e-3, stall, np.zeros(chain.n), DEFAULT_PLAN_SETTINGS)
    path = plan_calibration_path(machine, q)
    if path.trajectory is None:
        return
    onto_reference(path.trajectory, q, stall)
    times, motion = sample_trajectory(path.trajectory, 0.1)
    Ts_base_tcp = tcp_poses(chain, motion.q)
    Ts_base_cam = Ts_base_tcp @ machine.T_tcp_cam_left
    camera = CameraTrack(times, inverse_pose(Ts_base_cam[0]) @ Ts_base_cam)
    T_cam_tool = inverse_pose(machine.T_tcp_cam_left) @ machine.T_tcp_tool
    prior = prior_from_tool_marker(machine.T_tcp_tool[:3, :3], T_cam_tool[:3, :3], 0.03)
    estimate_camera_rotation(camera, EncoderTrack(times, Ts_base_tcp), machine.T_tcp_cam_left, prior)
    model = error_model(machine)
    tcp_poses_with_errors(model, motion.q, model.prior_mean)


def _nonsingular_posture(chain: Chain) -> Array:
    """Away from limits and singularities on a machine of Table 1; the middle of the ranges on any other."""
    q = (chain.q_min + chain.q_max) / 2.0
    if chain.n == 6:
        q[1:3] = np.deg2rad([45.0, -90.0])
        q[4] = q[1] + q[2]
    return np.clip(q, chain.q_min, chain.q_max)
