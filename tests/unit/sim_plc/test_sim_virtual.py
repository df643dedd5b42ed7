"""The whole machine in virtual time: deterministic for a seed, follows its reference, and its truth is logged."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from virtual_plc import MACHINE, quintic_knots

from benchmarks.simulator.virtual import VirtualMachine, VirtualRunError, run_virtual
from machine.chain import chain_of
from machine.effects.entries import EffectEntry
from machine.kinematics import tcp_pose
from machine.poses import inverse_pose
from machine.rotations import rotation_from_quat_wxyz
from protocol.codes import PlcState
from protocol.framing import RawFraming
from sim_plc.diagnosed import with_effects
from sim_plc.draw_world import draw_world
from sim_plc.machine_loop import MachineLoop
from sim_plc.truth_log import TruthLog

MOVE = np.deg2rad([2.0, 1.5, -1.5, 2.0, 2.0, 2.0])


@pytest.fixture(scope="module")
def worlds():
    return {preset: draw_world(MACHINE, preset, 1) for preset in ("ideal", "realistic")}


def there_and_back(world):
    q0 = world.q_start_rad
    start = np.round(q0 / (2 * np.pi / 262144)) * (2 * np.pi / 262144)
    return [quintic_knots(start, start + MOVE, 2.0), quintic_knots(start + MOVE, start, 2.0)]


@pytest.mark.parametrize("preset", ["ideal", "realistic"])
def test_the_same_seed_gives_the_same_run_to_the_bit(worlds, preset):
    world = worlds[preset]
    first, second = (run_virtual(world, there_and_back(world), settle_s=0.5) for _ in range(2))
    assert first.states == second.states
    for name in ("t_s", "q_encoder", "q_true", "q_ref", "valves", "Ts_base_tcp"):
        assert (getattr(first, name) == getattr(second, name)).all()
    assert first.states[-1] is PlcState.HOLD
    moved = np.abs(first.q_encoder - first.q_encoder[0]).max(axis=0)
    assert (moved > 0.5 * np.abs(MOVE)).all()


def test_the_ideal_machine_ends_where_its_reference_is(worlds):
    world = worlds["ideal"]
    trace = run_virtual(world, there_and_back(world)[:1], settle_s=6.0)
    assert np.abs(trace.q_encoder[-1] - trace.q_ref[-1]).max() < 1e-4  # rad: no dead band, no gravity
    nominal = tcp_pose(chain_of(MACHINE), trace.q_true[-1])
    assert np.abs(trace.Ts_base_tcp[-1] - nominal).max() < 1e-9


def test_a_trajectory_from_elsewhere_is_refused(worlds):
    virtual = VirtualMachine(worlds["ideal"])
    virtual.arm()
    with pytest.raises(VirtualRunError, match="plan from q_ref"):
        virtual.play(quintic_knots(virtual.q_ref + 0.01, virtual.q_ref + MOVE, 2.0))


def test_truth_log(worlds, tmp_path):
    world = worlds["realistic"]
    virtual = VirtualMachine(world)
    virtual.machine.truth = TruthLog(tmp_path, world, stand_off_m=0.2)
    virtual.step(1000)
    virtual.machine.truth.close()
    with (tmp_path / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 50
    t_ns = np.array([int(row["t_plc_ns"]) for row in rows])
    assert (np.diff(t_ns) == 20_000_000).all()
    assert all(row["t_plc_s"].replace(".", "").lstrip("0") == row["t_plc_ns"] for row in rows)
    last = {name: float(value) for name, value in rows[-1].items()}
    T_ooi_tool = inverse_pose(world.scene.T_base_ooi) @ virtual.machine.plant.T_base_tcp() @ world.scene.T_tcp_tool
    position = np.array([last[f"{axis}_ooi_tool_m"] for axis in "xyz"])
    assert np.abs(position - T_ooi_tool[:3, 3]).max() < 1e-4  # m; the plant creeps a little within 20 ms
    quat = np.array([last[f"q{c}_ooi_tool"] for c in "wxyz"])
    assert np.abs(rotation_from_quat_wxyz(quat) - T_ooi_tool[:3, :3]).max() < 1e-4
    error_mm = np.array([last[f"error_{axis}_mm"] for axis in "xyz"])
    assert error_mm == pytest.approx(position * 1e3 - [0, 0, 200.0], abs=1e-3)
    assert 0.0 < last["error_rotation_deg"] < 30.0
    assert abs(last["q_encoder_1_rad"] - world.q_start_rad[0]) < 1e-2
    drawn = json.loads((tmp_path / "world.json").read_text())
    assert drawn["preset"] == "realistic"
    assert drawn["seed"] == 1
    assert drawn["stand_off_m"] == 0.2
    assert np.array(drawn["camera"]["T_tcp_cam_left"]).shape == (4, 4)
    assert len(drawn["plant"]["kinematics"]["theta_zero_rad"]) == 6


@pytest.mark.parametrize("cycle_ms", [0.25, 0.5, 1.0, 1.5, 10.0])
def test_the_plant_moves_on_with_the_plcs_clock_whatever_its_cycle(cycle_ms):
    world = draw_world(replace(MACHINE, plc_cycle_s=1e-3 * cycle_ms), "ideal", 1)
    machine = MachineLoop(world, RawFraming(), 40_000_000_000, lambda: 1)
    for _ in range(round(600.0 / cycle_ms)):
        machine.run_cycle()
    assert machine.t_plc_ns == 40_600_000_000
    assert machine.plant.t_s == pytest.approx(0.6, abs=1e-6)


@pytest.mark.parametrize(("readout_s", "stamp_row", "late_s"), [(0.02, 0, 0.0), (0.02, 1, -0.01), (-0.02, -1, -0.01)])
def test_a_rolling_shutter_of_a_machine_file_stamps_the_row_that_it_says(readout_s, stamp_row, late_s):
    shutter = EffectEntry("rolling_shutter", None, (("readout_s", readout_s), ("stamp_row", float(stamp_row))))
    plain = draw_world(MACHINE, "ideal", 1)
    camera = with_effects(replace(plain, nominal=replace(MACHINE, effects=(shutter,)))).camera
    assert camera.readout_s - plain.camera.readout_s == pytest.approx(readout_s)
    assert camera.clock_offset_s - plain.camera.clock_offset_s == pytest.approx(late_s)
