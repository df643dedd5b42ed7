"""Does a machine still stand where a look was taken and a plan was made from it?"""

import numpy as np
from numpy.typing import ArrayLike

from machine.description import Machine
from machine.rotations import Array
from server.errors import PlanRefusedError
from server.jobs.knowledge import PreviewedPlan
from server.jobs.requests import MachineReading

LOOK_STALE_JOINT_MOTION_RAD = 2e-3  # joints further than this from where the look was taken make it stale: 8 mm at 4 m
SAME_REFERENCE_RAD = 1e-4  # four counts of an 18-bit encoder: while disarmed, the reference is what the encoders say


def require_unmoved(machine: Machine, reading: MachineReading, previewed: PreviewedPlan) -> None:
    """Raises: PlanRefusedError saying what moved, by how much, the limit, and what to do."""
    shift = float(np.abs(reading.q_ref_rad - previewed.q_ref_start).max())
    if shift > SAME_REFERENCE_RAD:
        raise PlanRefusedError(
            f"the machine's reference moved by {np.rad2deg(shift):.3f} deg since the preview "
            f"(limit {np.rad2deg(SAME_REFERENCE_RAD):.4f} deg); look and preview again"
        )
    stale = moved_since_look(machine, reading.q_rad, previewed.q_look)
    if stale:
        raise PlanRefusedError(stale)


def moved_since_look(machine: Machine, q_rad: ArrayLike, q_look: Array) -> str:
    """Why a look at q_look (n,) [rad] says nothing of a machine at q_rad (n,) [rad]; empty when it does.

    In HOLD the reference stays what it is however far a joint sinks, so the encoders are asked.
    """
    moved = np.asarray(q_rad) - q_look
    worst = int(np.argmax(np.abs(moved)))
    if abs(moved[worst]) <= LOOK_STALE_JOINT_MOTION_RAD:
        return ""
    return (
        f"joint {machine.joints[worst].name} moved by {np.rad2deg(moved[worst]):+.3f} deg since the look "
        f"(limit {np.rad2deg(LOOK_STALE_JOINT_MOTION_RAD):.3f} deg); look again"
    )
