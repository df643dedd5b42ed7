"""The second plant of the blind benchmark, simulated by Exudyn: the PATU 655 log crane with slew, lift and tilt.

Everything a real machine would send, by the same interface as the own plant (`plants.Plant`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from benchmarks.diagnosis.sealed import foreign_exudyn, foreign_valves
from benchmarks.diagnosis.sealed import foreign_geometry as g
from benchmarks.diagnosis.sealed import foreign_machine as m
from benchmarks.diagnosis.sealed import foreign_numbers as k
from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.faults import TUG, Faults, faults_of
from benchmarks.diagnosis.sealed.foreign_arm import ForeignArm, arm_of
from benchmarks.diagnosis.sealed.own_plant import Course, encoder_rows, true_at
from machine.description import Joint
from machine.rotations import Array

REST_HALF = np.array([0.9, 0.4, 0.5])  # of the poses at rest, about home [rad]


def play_of(faults: Faults) -> Array:
    """Width of each joint's play (3,) [rad], peak to peak."""
    play = np.array(k.PLAY_RAD)
    for one in faults.injected:
        if one.name == "backlash" and one.joint is not None:
            play[one.joint - 1] += one.size
    return play


@njit(cache=True)
def _played(x: Array, half: float) -> Array:
    y = np.empty_like(x)
    at = x[0]
    for i in range(len(x)):
        at = min(max(at, x[i] - half), x[i] + half)
        y[i] = at
    return y


@dataclass(frozen=True)
class ForeignPlant:
    """The crane in Exudyn."""

    home_rad = k.HOME_RAD
    motors = g.DRIVEN
    springs = g.SPRUNG
    play_rad = np.array(k.PLAY_RAD)

    @property
    def joints(self) -> Sequence[Joint]:
        """The nominal joints."""
        return m.joints()

    def toml(self) -> str:
        """The nominal machine file."""
        return m.toml()

    def T_base_ooi(self) -> Array:
        """Where the seen object stands: in front of the camera at home, its z towards the camera."""
        home = np.zeros(7)
        home[list(g.DRIVEN)] = k.HOME_RAD
        T = np.diag([1.0, -1.0, -1.0, 1.0])
        T[2, 3] = own.OOI_AHEAD_M
        return arm_of(faults_of((), 3)).tcp(home) @ own.six_joints().T_tcp_cam_left @ T

    def run(
        self, faults: Faults, ref: Array, shock: Array, u_given: Array | None = None, near: Array | None = None
    ) -> Course:
        """Drive it from home along the received reference (m, 3) [rad], a row every 5 ms; `near` is not kept:
        Exudyn's state is its own.
        """
        del near
        return run(faults, ref, shock, u_given)

    def arm(self, faults: Faults) -> ForeignArm:
        """The arm with the injected effects of the structure."""
        return arm_of(faults)

    def rest_poses(self, faults: Faults, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Encoder readings (m, 3) and tree angles (m, 7) of poses at rest; every third is visited twice."""
        readings = rng.uniform(k.HOME_RAD - REST_HALF, k.HOME_RAD + REST_HALF, (count, 3))
        readings = np.concatenate([readings, readings[::3]])
        encoder, play = encoder_rows(faults, 3), play_of(faults)
        bodies, out = g.tree_bodies(faults.of("payload_error")), np.zeros((len(readings), 7))
        for row, reading in enumerate(readings):
            out[row] = g.at_rest(bodies, true_at(reading, encoder))
            out[row, list(g.DRIVEN)] += 0.5 * play * rng.uniform(-1.0, 1.0, 3)
        return readings, out


def run(faults: Faults, ref: Array, shock: Array, u_given: Array | None = None) -> Course:
    """Drive the plant from home along the received reference (m, 3) [rad], a row every 5 ms.

    Args: shock: disturbance's innovations (m, 3) [rad/s]. u_given: (m, 3) valve commands for an open-loop run.
    """
    encoder = encoder_rows(faults, 3)
    bodies = g.tree_bodies(faults.of("payload_error"))
    at_rest = g.at_rest(bodies, true_at(ref[0], encoder))
    model = foreign_exudyn.build(bodies, at_rest)
    given = np.zeros((0, 3)) if u_given is None else u_given
    setup = foreign_valves.setup(faults, encoder, ref, shock, given)
    rows = foreign_valves.Rows(*(np.zeros((len(ref), columns)) for columns in (3, 3, 3, 7, 7)))
    _drive(model, setup, rows, faults, g.cylinder_forces(bodies, at_rest))
    for j, width in enumerate(play_of(faults)):
        rows.tree_q[:, 2 * j] = _played(rows.tree_q[:, 2 * j].copy(), 0.5 * float(width))
    return Course(enc=rows.enc, u=rows.u, smooth=rows.smooth, tree_q=rows.tree_q, pressures=rows.pressures)


def _drive(
    model: foreign_exudyn.Model,
    setup: foreign_valves.Setup,
    rows: foreign_valves.Rows,
    faults: Faults,
    forces: Array,
) -> None:
    """Exudyn's steps with PLC and valves between them."""
    state, opened = np.zeros((3, 9)), np.zeros(6)
    state[:, foreign_valves.FORCE] = forces
    system, data = model.system, model.system.systemData
    edges = [(one, f"valveOpening{side}") for one in model.actuators for side in (0, 1)]
    tug = faults.joint[:, TUG]

    def before_step(number: int) -> None:
        q, p = data.GetODE2Coordinates(), data.GetODE1Coordinates()
        row, within = divmod(number, foreign_valves.STEPS)
        if within == 0:
            foreign_valves.cycle(setup, state, rows, row, q, p)
        supply = foreign_valves.step(setup, state, number, q, p, opened)
        if within == 0:
            rows.pressures[row, 6] = supply
        for (actuator, name), value in zip(edges, opened, strict=True):
            system.SetObjectParameter(actuator, name, value)
        if tug.any():  # a cable that comes tight now and then
            torque = np.zeros(7)
            torque[list(g.DRIVEN)] = tug * max(np.sin(0.9 * number * foreign_valves.STEP_S) - 0.3, 0.0)
            system.SetObjectParameter(model.tree, "jointForceVector", torque)

    foreign_exudyn.solve(model, len(rows.enc) * foreign_valves.STEPS, before_step)
