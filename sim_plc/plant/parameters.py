"""From the truth to the arrays of the compiled loop."""

import numpy as np

from machine.rotations import Array
from sim_plc.plant.kernel import Parameters
from sim_plc.plant.statics import outboard_inertias
from sim_plc.plant.tree import FLEXES, MOTORS, Tree
from sim_plc.plant.truth import PlantTruth


def flex_damping(truth: PlantTruth, tree: Tree, q: Array) -> Array:
    """Damping of the flexible joints (5,) [N m s/rad].

    Model:   c = 2 zeta sqrt(k I), I = moment of inertia outboard of the joint at q.
    """
    inertia = outboard_inertias(tree, q)[FLEXES]
    return 2.0 * truth.flex.damping_ratio * np.sqrt(truth.flex.stiffness_nm_rad * inertia)


def _joint_rows(truth: PlantTruth) -> Array:
    valve, actuator, friction, kinematics = truth.valve, truth.actuator, truth.friction, truth.kinematics
    columns = (
        2.0 * np.pi * valve.frequency_hz,
        valve.damping,
        valve.rate_limit_1_s,
        valve.dead_band_frac,
        valve.hysteresis_frac,
        valve.flow_gain_m3_s_sqrt_pa,
        actuator.area_a,
        actuator.area_b,
        actuator.dead_volume_a_m3,
        actuator.dead_volume_b_m3,
        actuator.stroke,
        actuator.leakage_m3_s_pa,
        friction.coulomb,
        friction.static,
        friction.viscous,
        friction.stribeck,
        friction.bristle_stiffness,
        friction.bristle_damping,
        kinematics.q_stop_low_rad,
        kinematics.q_stop_high_rad,
        0.5 * kinematics.backlash_rad,
        actuator.table_q0_rad,
        actuator.table_step_rad,
        truth.velocity_gain_rad_s,
    )
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
        mass=tree.mass,
        com=tree.com,
        inertia=tree.inertia,
        armature=tree.armature,
        gravity=contiguous(truth.inertia.gravity_base_m_s2, dtype=float),
        motors=MOTORS.copy(),
        flexes=FLEXES.copy(),
        flex_k=contiguous(truth.flex.stiffness_nm_rad, dtype=float),
        flex_c=flex_damping(truth, tree, q),
        joint=_joint_rows(truth),
        table_y=contiguous(actuator.table_y),
        table_lever=contiguous(actuator.table_lever),
        oil=oil,
    )
