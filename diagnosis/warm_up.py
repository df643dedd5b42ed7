"""Compile what a diagnosis calls, by small inputs of the same types, so that no diagnosis waits for a compiler."""

import numpy as np

from diagnosis.behind.frame_descent import gauss_newton_rotations
from diagnosis.behind.link_angles import Path, link_angles
from diagnosis.whole_model.subsets import LinearProblem, best_set
from machine.description import Machine
from machine.effects.arm import arm_of
from machine.effects.dynamics import Actuators, actuators_of, drive_actuator, simulate
from machine.effects.kernel import BACKLASH
from machine.effects.layout import neutral_sets
from machine.effects.seen import seen_corners
from machine.effects.structure import tcp_poses
from machine.rotations import Array

WARM_UP_ROWS = 8


def warm_up(machine: Machine) -> None:
    """Call everything that is compiled once, with the machine's own chain."""
    best_set(_example_problem(), np.zeros(2, dtype=bool), np.ones(2, dtype=bool))
    plant = actuators_of(machine)
    for drives in (plant, Actuators(plant.joints[:1], plant.cycle_s, plant.log_cycle_s, plant.transport_delay_s)):
        simulate(
            drives,
            neutral_sets(drives.n),
            drive_actuator(drives, np.zeros((WARM_UP_ROWS, drives.n)), np.zeros(drives.n)),
        )
    sets = neutral_sets(plant.n)
    sets.joint_parameters[0, 0, BACKLASH] = 1e-3
    t_s: Array = np.linspace(0.0, 0.01 * (WARM_UP_ROWS - 1), WARM_UP_ROWS)
    path = Path(t_s, np.zeros((WARM_UP_ROWS, plant.n)), 0.01)
    link_angles((path,), sets, 0, np.zeros(1, dtype=np.int64), t_s[3:4])
    at_tcp = tcp_poses(arm_of(machine), sets, np.zeros((1, plant.n)))
    seen_corners(sets, machine.camera, machine.markers_on("ooi"), at_tcp)
    gauss_newton_rotations(np.eye(9), np.zeros(9), np.eye(3)[None], 1)


def _example_problem() -> LinearProblem:
    even = np.ones(2)
    return LinearProblem(np.eye(2), even, even, np.arange(3), np.zeros(2, dtype=bool), -even)
