"""Where the tool truly is at rest for given joints: true lengths and zeros, play, sag of five springs. Compiled."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.rotations import Array
from sim_plc.plant.aba import joint_frames
from sim_plc.plant.tree import FLEX_JOINT_INDICES, MOTOR_JOINT_INDICES, Tree, build_tree
from sim_plc.plant.truth import PlantTruth

_ROUNDS = 8  # each round shrinks the error about tenfold


class Structure:
    """One machine's true statics; rigid machines do not bend."""

    def __init__(self, truth: PlantTruth) -> None:
        self._tree: Tree = build_tree(truth.kinematics, truth.inertia)
        self._gravity = np.ascontiguousarray(truth.inertia.gravity_base_m_s2, dtype=float)
        stiffness = np.asarray(truth.flex.stiffness_nm_rad, dtype=float)
        self._compliance = np.zeros_like(stiffness) if truth.rigid else 1.0 / stiffness

    def tcp_poses(self, q_motor: Array, q_output: Array) -> Array:
        """True Ts_base_tcp (m, 4, 4) at rest with motors at (m, 6) and outputs, behind the play, at (m, 6) [rad]."""
        tree = self._tree
        motors = np.ascontiguousarray(np.atleast_2d(q_motor), dtype=float)
        outputs = np.ascontiguousarray(np.atleast_2d(q_output), dtype=float)
        Ts = np.zeros((len(motors), 4, 4))
        _tcp_poses(
            np.ascontiguousarray(tree.tree_R), np.ascontiguousarray(tree.tree_p), tree.mass_kg,
            np.ascontiguousarray(tree.com_m), self._gravity, self._compliance, MOTOR_JOINT_INDICES, FLEX_JOINT_INDICES,
            np.ascontiguousarray(tree.T_last_tcp), motors, outputs, Ts,
        )  # fmt: skip
        return Ts


@njit(cache=True, nogil=True)
def _sag(
    tree_R: Array, tree_p: Array, mass: Array, com: Array, gravity: Array, compliance: Array,
    flexes: NDArray[np.int64], q: Array, R: Array, p: Array,
) -> None:  # fmt: skip
    """One round of q_f = compliance times the gravity torque at each spring; frames R, p are left at the old angles.

    Model:   t_i = z_i . sum_k>=i (c_k - p_i) x m_k g, summed from the tip inwards.
    """
    joint_frames(tree_R, tree_p, q, R, p)
    n = q.shape[0]
    total_mass = 0.0
    moment = np.zeros(3)  # sum of m_k c_k
    k_flex = flexes.shape[0] - 1
    for i in range(n - 1, -1, -1):
        total_mass += mass[i]
        for row in range(3):
            centre = p[i, row]
            for column in range(3):
                centre += R[i, row, column] * com[i, column]
            moment[row] += mass[i] * centre
        if k_flex >= 0 and flexes[k_flex] == i:
            arm = moment - total_mass * p[i]
            torque = np.cross(arm, gravity)
            q[i] = compliance[k_flex] * (R[i, 0, 2] * torque[0] + R[i, 1, 2] * torque[1] + R[i, 2, 2] * torque[2])
            k_flex -= 1


@njit(cache=True, nogil=True)
def _tcp_poses(
    tree_R: Array, tree_p: Array, mass: Array, com: Array, gravity: Array, compliance: Array,
    motors: NDArray[np.int64], flexes: NDArray[np.int64], T_last_tcp: Array, q_motor: Array, q_output: Array, Ts: Array,
) -> None:  # fmt: skip
    n = tree_p.shape[0]
    q, R, p = np.zeros(n), np.zeros((n, 3, 3)), np.zeros((n, 3))
    for m in range(q_motor.shape[0]):
        for j in range(motors.shape[0]):
            q[motors[j]] = q_motor[m, j]
        for _ in range(_ROUNDS if m == 0 else 3):  # neighbours differ little
            _sag(tree_R, tree_p, mass, com, gravity, compliance, flexes, q, R, p)
        for j in range(motors.shape[0]):
            q[motors[j]] = q_output[m, j]
        joint_frames(tree_R, tree_p, q, R, p)
        Ts[m, 3, 3] = 1.0
        for row in range(3):
            Ts[m, row, 3] = p[n - 1, row]
            for inner in range(3):
                Ts[m, row, 3] += R[n - 1, row, inner] * T_last_tcp[inner, 3]
                for column in range(3):
                    Ts[m, row, column] += R[n - 1, row, inner] * T_last_tcp[inner, column]
