"""The nominal crane of this class: actuator sizes, oil, friction and link inertias, before any preset is drawn.

Marks: E read in a source or measured, K general knowledge, A assumption, C computed from those (docs/plant.md).
"""

import numpy as np

from machine.description import Machine
from machine.rotations import Array
from sim_plc.plant.cylinder import LIFT_GEOMETRY, TILT_GEOMETRY, interpolate_table, lever_table
from sim_plc.plant.statics import gravity_torques, steady_speed
from sim_plc.plant.tree import MOTOR_JOINT_INDICES, N_TREE_JOINTS, Tree
from sim_plc.plant.truth import ActuatorTruth, FrictionTruth, InertiaTruth, SupplyTruth, ValveTruth

BORE_M, ROD_M, STROKE_M = 0.080, 0.045, 0.545  # lift and tilt cylinder, K
AREA_BORE_M2 = np.pi / 4.0 * BORE_M**2
AREA_RING_M2 = np.pi / 4.0 * (BORE_M**2 - ROD_M**2)
SLEW_M3_RAD, WRIST_M3_RAD = 1.2e-3, 2.5e-4  # A
BULK_MODULUS_PA, LAMINAR_PA = 9e8, 2e5  # E
DEAD_A_M3, DEAD_B_M3 = 1.9e-4, 2.5e-4  # lift, tilt, slew: E
WRIST_DEAD_VOLUME_M3 = 1.0e-4  # A: thinner hoses
SUPPLY_PA, TANK_PA = 19e6, 1e5  # K, E
FLOW_MAX_M3_S = 60.0 / 60e3  # 60 l/min for all joints, A
DROOP_PA, ACCUMULATOR_M3_PA = 5e5, 5e-11  # A: pump compensator, about 1 litre of gas
PRESSURE_RIPPLE_HZ = 12.0  # A: hunting of the compensator, above the structure's modes
OIL_TEMPERATURE_C = 40.0  # A
VALVE_RATE_1_S = 100.0  # A: full stroke in 10 ms
END_STOP_MARGIN_RAD = np.deg2rad(1.5)  # A
ROTOR_KG_M2 = np.array(
    [30.0, 30.0, 30.0, 2.0, 2.0, 1.0]
)  # A; a body before a spring needs real inertia, else 0.25 ms diverge

# Cylinder friction: E (210 N, 300 N, 330 N s/m, 5 mm/s; lift 5 times the Coulomb part).
# Rotary: A, 1.5 % of stall, breakaway 1.2-1.3 times that.
COULOMB_FRICTION = np.array([340.0, 1050.0, 210.0, 70.0, 70.0, 70.0])
STATIC_FRICTION = np.array([440.0, 1500.0, 300.0, 84.0, 84.0, 84.0])
VISCOUS_FRICTION = np.array([400.0, 330.0, 330.0, 30.0, 30.0, 30.0])
STRIBECK_VELOCITY = np.array([0.01, 0.005, 0.005, 0.01, 0.01, 0.01])
BREAKAWAY_BRISTLE_DEFLECTION = np.array([2e-4, 5e-5, 5e-5, 3e-4, 3e-4, 3e-4])  # deflection at breakaway [rad or m], A
REFLECTED_INERTIA_MIN = np.array(
    [30.0, 300.0, 500.0, 2.0, 2.0, 1.0]
)  # rotor inertia seen by the actuator [kg m2 or kg], C

SIZING_POSTURE_RAD = np.deg2rad([0.0, 45.0, -95.0, 0.0, -50.0, 0.0])  # middle of the working postures
_LINK_SIZE_M = np.array(
    [  # cuboids of even density for the links' inertias, in link DH axes, A
        [0.35, 1.60, 0.35],
        [1.95, 0.22, 0.18],
        [0.18, 0.20, 2.10],
        [0.22, 0.35, 0.22],
        [0.20, 0.20, 0.25],
        [0.30, 0.55, 0.25],
    ]
)


def link_inertias(machine: Machine) -> InertiaTruth:
    """Masses and CoMs from the machine file, inertias as even cuboids."""
    mass = np.array([joint.mass_kg for joint in machine.joints])
    squares = _LINK_SIZE_M**2
    moments = mass[:, None] / 12.0 * (squares.sum(axis=1)[:, None] - squares)
    return InertiaTruth(
        gravity_base_m_s2=machine.gravity_base_m_s2,
        mass_kg=mass,
        com_m=np.array([joint.com_m for joint in machine.joints]),
        inertia_com_kg_m2=np.array([np.diag(row) for row in moments]),
        armature_kg_m2=ROTOR_KG_M2.copy(),
    )


def build_actuator_truth(machine: Machine) -> ActuatorTruth:
    """Slew and wrists rotary, lift and tilt asymmetric cylinders with their levers."""
    geometries = (None, LIFT_GEOMETRY, TILT_GEOMETRY, None, None, None)
    low = np.array([joint.q_min_rad for joint in machine.joints]) - 2.0 * END_STOP_MARGIN_RAD
    high = np.array([joint.q_max_rad for joint in machine.joints]) + 2.0 * END_STOP_MARGIN_RAD
    tables = [lever_table(g, a, b) for g, a, b in zip(geometries, low, high, strict=True)]
    stroke = np.array([STROKE_M if g is not None else b - a for g, a, b in zip(geometries, low, high, strict=True)])
    y = np.array([table + 0.5 * (full - table[-1]) for (table, _), full in zip(tables, stroke, strict=True)])
    rotary = np.array([SLEW_M3_RAD, 0.0, 0.0, WRIST_M3_RAD, WRIST_M3_RAD, WRIST_M3_RAD])
    cylinder = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    return ActuatorTruth(
        area_a=rotary + cylinder * AREA_BORE_M2,
        area_b=rotary + cylinder * AREA_RING_M2,
        dead_volume_a_m3=np.array([DEAD_A_M3] * 3 + [WRIST_DEAD_VOLUME_M3] * 3),
        dead_volume_b_m3=np.array([DEAD_B_M3] * 3 + [WRIST_DEAD_VOLUME_M3] * 3),
        stroke=stroke,
        leakage_m3_s_pa=np.zeros(6),
        bulk_modulus_pa=BULK_MODULUS_PA,
        laminar_pa=LAMINAR_PA,
        table_q0_rad=low,
        table_step_rad=(high - low) / (y.shape[1] - 1),
        table_y=y,
        table_lever=np.array([lever for _, lever in tables]),
    )


def friction(scale: Array, viscous_only: bool) -> FrictionTruth:
    """LuGre parameters, Coulomb, static and viscous parts times `scale` (6,)."""
    keep = 0.0 if viscous_only else 1.0
    stiffness = keep * scale * STATIC_FRICTION / BREAKAWAY_BRISTLE_DEFLECTION
    return FrictionTruth(
        coulomb=keep * scale * COULOMB_FRICTION,
        static=keep * scale * STATIC_FRICTION,
        viscous=VISCOUS_FRICTION if viscous_only else scale * VISCOUS_FRICTION,
        stribeck=STRIBECK_VELOCITY.copy(),
        bristle_stiffness=stiffness,
        bristle_damping=np.sqrt(stiffness * REFLECTED_INERTIA_MIN),
    )


def build_supply_truth(ripple_pa: float, ripple_phase_rad: float) -> SupplyTruth:
    """Pump and tank."""
    return SupplyTruth(
        pressure_pa=SUPPLY_PA,
        tank_pa=TANK_PA,
        ripple_pa=ripple_pa,
        ripple_hz=PRESSURE_RIPPLE_HZ,
        ripple_phase_rad=ripple_phase_rad,
        flow_max_m3_s=FLOW_MAX_M3_S,
        droop_pa=DROOP_PA,
        accumulator_m3_pa=ACCUMULATOR_M3_PA,
        oil_temperature_c=OIL_TEMPERATURE_C,
    )


def joint_speeds(tree: Tree, gravity: Array, actuator: ActuatorTruth, gain: Array, q: Array) -> Array:
    """Steady joint speeds at full command, (6, 2) [rad/s] up and down, both positive, at motor angles q (6,) [rad].

    Model:   load = gravity torque over the lever plus or minus nominal Coulomb and viscous friction (fixed point).
    """
    q_all = np.zeros(N_TREE_JOINTS)
    q_all[MOTOR_JOINT_INDICES] = q
    holding = -gravity_torques(tree, gravity, q_all)[MOTOR_JOINT_INDICES]
    speeds = np.zeros((6, 2))
    for j in range(6):
        lever = interpolate_table(actuator.table_lever[j], actuator.table_q0_rad[j], actuator.table_step_rad[j], q[j])
        for column, sign in enumerate((1.0, -1.0)):
            speed = 0.0
            for _ in range(3):
                load = holding[j] / lever + sign * (COULOMB_FRICTION[j] + VISCOUS_FRICTION[j] * speed)
                speed = steady_speed(
                    load, gain[j], actuator.area_a[j], actuator.area_b[j], SUPPLY_PA, TANK_PA, LAMINAR_PA, sign > 0.0
                )
            speeds[j, column] = speed / lever
    return speeds


def flow_gains(machine: Machine, tree: Tree, gravity: Array, actuator: ActuatorTruth) -> Array:
    """Flow gain per edge (6,) [m3/s/sqrt Pa] that gives the machine file's velocity gains at the sizing posture.

    Model:   mean of the speeds up and down at full command = velocity_gain_rad_s, nominal machine and load.
    """
    wanted = np.array([joint.velocity_gain_rad_s for joint in machine.joints])
    gain = np.full(6, 1e-7)
    for _ in range(4):
        gain *= wanted / joint_speeds(tree, gravity, actuator, gain, SIZING_POSTURE_RAD).mean(axis=1)
    return gain


def valves(
    machine: Machine, flow_gain: Array, dead_band_frac: Array, hysteresis_frac: Array, rigid: bool
) -> ValveTruth:
    """Valves with the machine file's dynamics; the rigid machine's are not rate limited."""
    return ValveTruth(
        frequency_hz=np.array([joint.valve_frequency_hz for joint in machine.joints]),
        damping=np.array([joint.valve_damping for joint in machine.joints]),
        rate_limit_1_s=np.full(6, 1e9 if rigid else VALVE_RATE_1_S),
        dead_band_frac=dead_band_frac,
        hysteresis_frac=hysteresis_frac,
        flow_gain_m3_s_sqrt_pa=flow_gain,
    )
