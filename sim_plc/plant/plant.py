"""The simulated machine in motion: valve commands in, encoder readings, pressures and the true tool pose out."""

import numpy as np

from machine.rotations import Array
from sim_plc.plant import kernel
from sim_plc.plant.aba import aba_work
from sim_plc.plant.kernel import Parameters
from sim_plc.plant.statics import (
    frames,
    gravity_torques,
    outboard_inertias,
    resting_pressures,
    static_equilibrium_angles,
)
from sim_plc.plant.tree import FLEX_JOINT_INDICES, MOTOR_JOINT_INDICES, N_TREE_JOINTS, Tree, build_tree
from sim_plc.plant.truth import PlantTruth

# From the truth to the arrays of the compiled loop.


def flex_damping(truth: PlantTruth, tree: Tree, q: Array) -> Array:
    """Damping of the flexible joints (5,) [N m s/rad].

    Model:   c = 2 zeta sqrt(k I), I = moment of inertia outboard of the joint at q.
    """
    inertia = outboard_inertias(tree, q)[FLEX_JOINT_INDICES]
    return 2.0 * truth.flex.damping_ratio * np.sqrt(truth.flex.stiffness_nm_rad * inertia)


def _joint_rows(truth: PlantTruth) -> Array:
    valve, actuator, friction, kinematics = truth.valve, truth.actuator, truth.friction, truth.kinematics
    # fmt: off
    columns = (
        2.0 * np.pi * valve.frequency_hz, valve.damping, valve.rate_limit_1_s, valve.dead_band_frac,
        valve.hysteresis_frac, valve.flow_gain_m3_s_sqrt_pa, actuator.area_a, actuator.area_b,
        actuator.dead_volume_a_m3, actuator.dead_volume_b_m3, actuator.stroke, actuator.leakage_m3_s_pa,
        friction.coulomb, friction.static, friction.viscous, friction.stribeck, friction.bristle_stiffness,
        friction.bristle_damping, kinematics.q_stop_low_rad, kinematics.q_stop_high_rad, 0.5 * kinematics.backlash_rad,
        actuator.table_q0_rad, actuator.table_step_rad, truth.velocity_gain_rad_s,
    )
    # fmt: on
    return np.ascontiguousarray(np.stack(columns, axis=1))


def parameters_of(truth: PlantTruth, tree: Tree, q: Array) -> Parameters:
    """All constants of one machine; q (11,) [rad] is where the structural damping is referred to."""
    supply, actuator = truth.supply, truth.actuator
    oil = np.array(
        [
            actuator.bulk_modulus_pa,
            actuator.laminar_pa,
            supply.pressure_pa,
            supply.tank_pa,
            supply.ripple_pa,
            2.0 * np.pi * supply.ripple_hz,
            supply.ripple_phase_rad,
            supply.flow_max_m3_s,
            supply.droop_pa,
            supply.accumulator_m3_pa,
        ]
    )
    contiguous = np.ascontiguousarray
    return Parameters(
        tree_R=contiguous(tree.tree_R),
        tree_p=contiguous(tree.tree_p),
        mass_kg=tree.mass_kg,
        com_m=tree.com_m,
        inertia_kg_m2=tree.inertia_kg_m2,
        armature_kg_m2=tree.armature_kg_m2,
        gravity_m_s2=contiguous(truth.inertia.gravity_base_m_s2, dtype=float),
        motor_joints=MOTOR_JOINT_INDICES.copy(),
        flex_joints=FLEX_JOINT_INDICES.copy(),
        flex_k=contiguous(truth.flex.stiffness_nm_rad, dtype=float),
        flex_c=flex_damping(truth, tree, q),
        joint_parameters=_joint_rows(truth),
        table_y=contiguous(actuator.table_y),
        table_lever=contiguous(actuator.table_lever),
        oil_parameters=oil,
    )


class Plant:
    """One machine, started at rest: sag in place, pressures carrying the weight, valves closed.

    Args:    truth: the machine. q_start: encoder readings at the start, (6,) [rad].
    Deterministic: the same truth, start and commands give the same motion to the bit.
    """

    def __init__(self, truth: PlantTruth, q_start: Array) -> None:
        self.truth = truth
        self.tree: Tree = build_tree(truth.kinematics, truth.inertia)
        self._resolution = 2.0 * np.pi / truth.kinematics.encoder_counts_rev
        q_start = np.asarray(q_start, dtype=float)
        if q_start.shape != (6,) or not np.all(np.isfinite(q_start)):
            raise ValueError(f"q_start must be 6 finite angles [rad], got shape {q_start.shape}")
        q = np.zeros(N_TREE_JOINTS)
        q[MOTOR_JOINT_INDICES] = q_start
        if not truth.rigid:
            q = static_equilibrium_angles(
                self.tree, truth.inertia.gravity_base_m_s2, q_start, truth.flex.stiffness_nm_rad
            )
        self.parameters = parameters_of(truth, self.tree, q)
        self.state = self._resting_state(q)
        self._advance = kernel.advance_rigid if truth.rigid else kernel.advance

    def _resting_state(self, q: Array) -> kernel.State:
        truth = self.truth
        joint = np.zeros((6, 7))
        joint[:, kernel.OUTPUT] = (
            q[MOTOR_JOINT_INDICES] + 0.5 * truth.kinematics.backlash_rad * truth.kinematics.play_start_frac
        )
        holding = -gravity_torques(self.tree, truth.inertia.gravity_base_m_s2, q)[MOTOR_JOINT_INDICES]
        for j in range(6):
            row = self.parameters.joint_parameters[j]
            lever = kernel.interpolate_table(
                self.parameters.table_lever[j],
                row[kernel.TABLE_Q0],
                row[kernel.TABLE_STEP],
                float(q[MOTOR_JOINT_INDICES[j]]),
            )
            joint[j, kernel.P_A], joint[j, kernel.P_B] = resting_pressures(
                holding[j] / lever,
                row[kernel.AREA_A],
                row[kernel.AREA_B],
                truth.supply.pressure_pa,
                truth.supply.tank_pa,
            )
        zeros = np.zeros(N_TREE_JOINTS)
        shared = np.array([truth.supply.pressure_pa, 0.0])
        return kernel.State(q.copy(), zeros.copy(), joint, shared, zeros.copy(), zeros.copy(), aba_work(N_TREE_JOINTS))

    def step(self, valve_command: Array, n_ms: int = 1) -> None:
        """Advance by n_ms milliseconds with the commands (6,) [fraction of full command, clipped to -1..1] held.

        Raises:  ValueError: wrong shape or a command that is not finite.
        """
        command = np.ascontiguousarray(valve_command, dtype=np.float64)
        if command.shape != (6,) or not np.isfinite(command).all():
            raise ValueError(f"valve_command must be 6 finite fractions, got {valve_command!r}")
        self._advance(self.parameters, self.state, command, n_ms)

    @property
    def t_s(self) -> float:
        """Simulated time since the start [s]."""
        return float(self.state.shared_states[kernel.TIME])

    @property
    def q_encoder_rad(self) -> Array:
        """Encoder readings (6,) [rad]: motor angles before flexible joints and play, quantised."""
        return np.round(self.state.q[MOTOR_JOINT_INDICES] / self._resolution) * self._resolution

    @property
    def qd_rad_s(self) -> Array:
        """Motor speeds (6,) [rad/s], as a drive with a fast counter would report them."""
        return self.state.qd[MOTOR_JOINT_INDICES]

    @property
    def pressures_pa(self) -> Array:
        """Chamber pressures A, B of every joint, (6, 2) [Pa]."""
        return self.state.joint_states[:, kernel.P_A : kernel.P_B + 1].copy()

    @property
    def supply_pressure_pa(self) -> float:
        """Supply pressure without ripple [Pa]."""
        return float(self.state.shared_states[kernel.P_SUPPLY])

    @property
    def oil_temperature_c(self) -> float:
        """Oil temperature [deg C], constant."""
        return self.truth.supply.oil_temperature_c

    @property
    def q_output_rad(self) -> Array:
        """True joint angles behind the play (6,) [rad]."""
        return self.state.joint_states[:, kernel.OUTPUT].copy()

    @property
    def q_flex_rad(self) -> Array:
        """True angles of the flexible joints (5,) [rad]: lift (vertical, lateral), tilt (same), wrist mount."""
        return self.state.q[FLEX_JOINT_INDICES]

    def T_base_tcp(self) -> Array:
        """True pose of the tcp in base (4, 4): through the true DH table, play and bending."""
        q = self.state.q.copy()
        q[MOTOR_JOINT_INDICES] = self.state.joint_states[:, kernel.OUTPUT]
        R, p = frames(self.tree, q)
        T_base_last = np.eye(4)
        T_base_last[:3, :3], T_base_last[:3, 3] = R[-1], p[-1]
        return T_base_last @ self.tree.T_last_tcp
