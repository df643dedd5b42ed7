"""Draws the true mechanics and hydraulics of one machine: one random stream per effect."""

import numpy as np

from machine.description import Machine
from machine.rotations import Array
from sim_plc.plant import sizing
from sim_plc.plant.tree import build_tree
from sim_plc.plant.truth import FlexTruth, KinematicTruth, PlantTruth
from sim_plc.presets import spread_of
from sim_plc.world import rng_for

# Lengths that carry an error: a1, a2, a3 and d1, d3, d4, d6; the wrist's other lengths are zero by design.
_A_UNCERTAIN = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
_D_UNCERTAIN = np.array([1.0, 0.0, 1.0, 1.0, 0.0, 1.0])


def draw_plant(machine: Machine, preset: str, seed: int) -> PlantTruth:
    """The plant of one preset and seed around a nominal six-joint machine."""

    def draw(name: str, n: int = 6, stream: str | None = None) -> Array:
        return spread_of(preset, name).draw(rng_for(seed, stream or name), n)

    rigid = bool(draw("rigid", 1)[0])
    inertia = sizing.link_inertias(machine)
    actuator = sizing.build_actuator_truth(machine)
    nominal = nominal_kinematics(machine)
    gains = sizing.flow_gains(machine, build_tree(nominal, inertia), inertia.gravity_base_m_s2, actuator)
    phase = float(rng_for(seed, "supply_ripple_phase").uniform(0.0, 2.0 * np.pi))
    return PlantTruth(
        rigid=rigid,
        velocity_gain_rad_s=np.array([joint.velocity_gain_rad_s for joint in machine.joints]),
        kinematics=_draw_kinematics(nominal, preset, seed),
        inertia=inertia,
        flex=FlexTruth(
            stiffness_nm_rad=np.concatenate(
                [
                    draw("spring_lift", 1),
                    draw("spring_lateral", 1, "spring_lift_lateral"),
                    draw("spring_tilt", 1),
                    draw("spring_lateral", 1, "spring_tilt_lateral"),
                    draw("spring_wrist_mount", 1),
                ]
            ),
            damping_ratio=draw("spring_damping", 5),
        ),
        valve=sizing.valves(machine, gains, draw("dead_band") * 1e-2, draw("hysteresis") * 1e-2, rigid),
        actuator=actuator,
        supply=sizing.build_supply_truth(float(draw("supply_ripple", 1)[0]), phase),
        friction=sizing.friction(draw("friction_scale"), rigid),
    )


def nominal_kinematics(machine: Machine) -> KinematicTruth:
    """The machine file's own chain, without errors or play."""

    def column(name: str) -> Array:
        return np.array([getattr(joint, name) for joint in machine.joints], dtype=float)

    return KinematicTruth(
        a_m=column("a_m"),
        d_m=column("d_m"),
        alpha_rad=column("alpha_rad"),
        theta_zero_rad=column("theta_offset_rad"),
        T_flange_tcp=machine.T_flange_tcp,
        q_stop_low_rad=column("q_min_rad") - sizing.END_STOP_MARGIN_RAD,
        q_stop_high_rad=column("q_max_rad") + sizing.END_STOP_MARGIN_RAD,
        encoder_counts_rev=column("encoder_counts_rev"),
        backlash_rad=np.zeros(6),
        play_start_frac=np.zeros(6),
    )


def _draw_kinematics(nominal: KinematicTruth, preset: str, seed: int) -> KinematicTruth:
    lengths = spread_of(preset, "dh_length").draw(rng_for(seed, "dh_length"), 12)
    zeros = spread_of(preset, "joint_zero").draw(rng_for(seed, "joint_zero"), 6)
    slew = spread_of(preset, "backlash_slew").draw(rng_for(seed, "backlash_slew")) * 1e-3
    wrist = np.deg2rad(spread_of(preset, "backlash_wrist").draw(rng_for(seed, "backlash_wrist"), 3))
    return KinematicTruth(
        a_m=nominal.a_m + _A_UNCERTAIN * lengths[:6],
        d_m=nominal.d_m + _D_UNCERTAIN * lengths[6:],
        alpha_rad=nominal.alpha_rad,
        theta_zero_rad=nominal.theta_zero_rad + np.deg2rad(zeros),
        T_flange_tcp=nominal.T_flange_tcp,
        q_stop_low_rad=nominal.q_stop_low_rad,
        q_stop_high_rad=nominal.q_stop_high_rad,
        encoder_counts_rev=2.0 ** spread_of(preset, "encoder").draw(rng_for(seed, "encoder"), 6),
        backlash_rad=np.concatenate([slew, np.zeros(2), wrist]),
        play_start_frac=rng_for(seed, "play_start").uniform(-1.0, 1.0, 6),
    )
