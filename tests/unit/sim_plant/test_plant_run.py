"""The whole plant: rest, motion, nominal model, determinism, the shipped gains, and the uncompiled fallback."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.simulator.closed_loop import Gains, run_closed_loop
from benchmarks.simulator.plant import bench_plant
from benchmarks.simulator.tuning import SPEEDS_RAD_S, is_stable, posture_box
from machine.chain import chain_of
from machine.kinematics import tcp_pose
from sim_plc.plant.plant import Plant

ROOT = Path(__file__).parents[3]


def _gains(machine):
    return Gains(
        np.array([joint.kp_frac_per_rad for joint in machine.joints]),
        np.array([joint.pt1_tau_s for joint in machine.joints]),
    )


def test_stands_still_with_valves_closed(realistic):
    plant = Plant(realistic.plant, realistic.q_start_rad)
    before = plant.T_base_tcp()
    plant.step(np.zeros(6), 10_000)
    assert np.abs(plant.T_base_tcp() - before)[:3, 3].max() < 1e-4  # m in 10 s
    assert np.abs(plant.q_encoder_rad - realistic.q_start_rad).max() < 1.3e-5  # rad, half an encoder step


def test_stiction_holds_and_does_not_creep_after_a_move(realistic, nominal):
    q_ref = np.repeat(realistic.q_start_rad[None], 22_000, axis=0)
    ramp = np.minimum(np.arange(22_000) * 1e-3, 2.0)[:, None]
    q_ref += ramp * np.deg2rad([2.0, -1.0, 1.5, 1.0, 1.0, 1.0])
    run = run_closed_loop(Plant(realistic.plant, realistic.q_start_rad), _gains(nominal), q_ref)
    assert np.abs(run.p_base_tcp[-1] - run.p_base_tcp[1200]).max() < 1e-4 + 4e-4  # m: 10 s creep + last oscillation
    assert np.abs(run.p_base_tcp[-1] - run.p_base_tcp[-300]).max() < 1e-4  # m in the last 3 s
    assert np.abs(run.q[-1] - q_ref[-1]).max() < np.deg2rad(0.8)  # dead band over gain, plus stiction


def test_starts_in_balance(realistic):
    plant = Plant(realistic.plant, realistic.q_start_rad)
    pressures = plant.pressures_pa
    assert pressures.min() > 1e6  # Pa
    assert pressures.max() < plant.supply_pressure_pa
    plant.step(np.zeros(6), 200)
    assert np.abs(plant.pressures_pa - pressures).max() < 1e3  # Pa
    assert np.abs(plant.qd_rad_s).max() < 1e-9  # rad/s


def test_speeds_are_near_the_nominal_gain(realistic, nominal):
    for j, joint in enumerate(nominal.joints):
        command = np.zeros(6)
        command[j] = 0.25
        plant = Plant(realistic.plant, realistic.q_start_rad)
        plant.step(command, 500)
        first = plant.q_encoder_rad[j]
        plant.step(command, 1500)
        dead_band = realistic.plant.valve.dead_band_frac[j]
        expected = joint.velocity_gain_rad_s * (0.245 - dead_band) / (1.0 - dead_band)
        assert (plant.q_encoder_rad[j] - first) / 1.5 == pytest.approx(expected, rel=0.2)


def test_commands_inside_the_dead_band_move_nothing(realistic):
    plant = Plant(realistic.plant, realistic.q_start_rad)
    plant.step(0.9 * realistic.plant.valve.dead_band_frac, 2000)
    assert np.abs(plant.q_encoder_rad - realistic.q_start_rad).max() < 1.3e-5  # rad


def test_bending_is_invisible_to_the_encoder(realistic, nominal):
    plant = Plant(realistic.plant, realistic.q_start_rad)
    believed = tcp_pose(chain_of(nominal), plant.q_encoder_rad)
    assert np.linalg.norm((plant.T_base_tcp() - believed)[:3, 3]) > 5e-3  # m: sag, lengths and zeros
    assert np.abs(plant.q_flex_rad[[0, 2]]).min() > 1e-4  # rad


def test_output_stays_inside_its_play(realistic):
    plant = Plant(realistic.plant, realistic.q_start_rad)
    half = 0.5 * realistic.plant.kinematics.backlash_rad
    for sign in (1.0, -1.0, 1.0):
        plant.step(np.full(6, 0.2 * sign), 300)
        gap = np.abs(plant.q_output_rad - plant.state.q[[0, 1, 4, 8, 9, 10]])
        assert np.all(gap <= half + 1e-12)  # rad
    assert np.all(half[[0, 3, 4, 5]] > 0.0)
    assert np.all(half[[1, 2]] == 0.0)


def test_pump_droops_when_every_joint_runs(realistic):
    plant = Plant(realistic.plant, realistic.q_start_rad)
    plant.step(np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0]), 500)
    assert plant.supply_pressure_pa < 16e6  # Pa: the joints want more than 60 l/min


def test_ideal_machine_is_the_nominal_model(ideal, nominal):
    plant = Plant(ideal.plant, ideal.q_start_rad)
    np.testing.assert_allclose(plant.T_base_tcp(), tcp_pose(chain_of(nominal), ideal.q_start_rad), atol=1e-12)  # m
    command = np.array([0.1, 0.05, -0.1, 0.2, 0.05, -0.1])
    plant.step(command, 1000)
    gain = np.array([joint.velocity_gain_rad_s for joint in nominal.joints])
    lag_s = 2.0 * 0.7 / (2.0 * np.pi * 40.0)
    np.testing.assert_allclose(
        plant.q_encoder_rad - ideal.q_start_rad, gain * command * (1.0 - lag_s), atol=1.5e-4
    )  # rad
    before = plant.q_encoder_rad
    plant.step(np.zeros(6), 200)
    plant.step(np.zeros(6), 2000)
    assert np.abs(plant.q_encoder_rad - before).max() < 2e-3  # rad


def test_same_truth_and_commands_give_the_same_motion_to_the_bit(realistic):
    rng = np.random.default_rng(5)
    commands = rng.uniform(-0.3, 0.3, size=(20, 6))
    plants = [Plant(realistic.plant, realistic.q_start_rad) for _ in range(2)]
    for command in commands:
        plants[0].step(command, 25)
        for _ in range(25):
            plants[1].step(command)
    assert np.array_equal(plants[0].state.q, plants[1].state.q)
    assert np.array_equal(plants[0].pressures_pa, plants[1].pressures_pa)


@pytest.mark.parametrize("command", [np.zeros(5), np.full(6, np.nan)])
def test_unusable_commands_are_refused(realistic, command):
    with pytest.raises(ValueError, match="6 finite"):
        Plant(realistic.plant, realistic.q_start_rad).step(command)


def test_shipped_gains_have_six_decibels_in_hand(nominal):
    gains = _gains(nominal)
    case = posture_box(nominal, "realistic", 4)[-1]  # the longest reach
    for joint in range(6):
        doubled = gains.kp.copy()
        doubled[joint] *= 2.0
        for speed in SPEEDS_RAD_S:
            assert is_stable(nominal, case, Gains(doubled, gains.tau), joint, speed)


def test_much_too_high_a_slew_gain_is_recognised(nominal):
    gains = _gains(nominal)
    case = posture_box(nominal, "realistic", 4)[-1]
    too_high = gains.kp.copy()
    too_high[0] = 24.0
    assert not all(is_stable(nominal, case, Gains(too_high, gains.tau), 0, speed) for speed in SPEEDS_RAD_S)


def test_bench_reports_both_ways_of_calling():
    result = bench_plant(0.5)
    assert result.simulated_s == 0.5
    assert result.real_time_factor > 1.0


def test_runs_without_compiling():
    program = """
import numpy as np
from pathlib import Path
from machine.description import parse_machine_toml
from sim_plc.draw_plant import draw_plant
from sim_plc.plant.plant import Plant
machine = parse_machine_toml(Path("machine/machines/hiab033.toml").read_text())
plant = Plant(draw_plant(machine, "realistic", 3), np.deg2rad([5.0, 45.0, -95.0, 3.0, -50.0, 2.0]))
plant.step(np.full(6, 0.2), 10)
print(*plant.state.q.tolist())
"""
    outputs = []
    for disabled in ("0", "1"):
        environment = {**os.environ, "NUMBA_DISABLE_JIT": disabled}
        done = subprocess.run(
            [sys.executable, "-c", program],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        outputs.append(np.array([float(word) for word in done.stdout.split()]))
    np.testing.assert_allclose(outputs[1], outputs[0], rtol=0.0, atol=1e-12)  # rad
