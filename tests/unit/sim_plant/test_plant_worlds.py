"""Presets and drawn worlds: the table's numbers, streams, and what a usable scene means."""

import numpy as np
import pytest

from machine.poses import inverse_pose
from machine.rotations import geodesic_angle, rotvec_from_rotation
from sim_plc.draw_world import all_in_view, draw_world, scene_fault, tool_stations, wall_clearance
from sim_plc.plant.plant import Plant
from sim_plc.presets import PRESET_NAMES, PRESET_TABLE, Exact, Normal, PresetError, Uniform, spread_of
from sim_plc.world import rng_for

SEEDS = range(8)


@pytest.fixture(scope="module")
def worlds(nominal):
    return {preset: [draw_world(nominal, preset, seed) for seed in SEEDS] for preset in PRESET_NAMES}


@pytest.mark.parametrize(
    ("preset", "name", "spread"),
    [
        ("realistic", "dh_length", Normal(3.5e-3)),
        ("realistic", "joint_zero", Normal(0.25)),
        ("realistic", "spring_lift", Uniform(0.6e6, 1.5e6)),
        ("realistic", "spring_tilt", Uniform(0.4e6, 1.0e6)),
        ("paper", "spring_lateral", Uniform(2.5e5, 6e5)),
        ("realistic", "backlash_slew", Uniform(0.5, 2.0)),
        ("realistic", "dead_band", Uniform(1.0, 3.0)),
        ("paper", "dead_band", Exact(3.0)),
        ("ideal", "dead_band", Exact(0.0)),
        ("paper", "mount_angle", Exact(5.0)),
        ("paper", "tool_marker_angle", Normal(3.0)),
        ("paper", "clock_offset", Exact(0.150)),
        ("ideal", "latency", Exact(0.040)),
        ("realistic", "wall_relief", Exact(0.050)),
    ],
)
def test_the_table_has_the_agreed_numbers(preset, name, spread):
    assert spread_of(preset, name) == spread


def test_every_row_names_its_unit_and_source():
    assert len({row.name for row in PRESET_TABLE}) == len(PRESET_TABLE)
    assert all(row.unit and row.source for row in PRESET_TABLE)


def test_unknown_preset_is_named(nominal):
    with pytest.raises(PresetError, match="'rusty' does not exist; choose one of ideal, realistic, paper"):
        draw_world(nominal, "rusty", 1)


def test_the_same_seed_gives_the_same_world(nominal):
    one, two = draw_world(nominal, "realistic", 11), draw_world(nominal, "realistic", 11)
    assert np.array_equal(one.scene.T_base_ooi, two.scene.T_base_ooi)
    assert np.array_equal(one.q_start_rad, two.q_start_rad)
    assert np.array_equal(one.plant.kinematics.a_m, two.plant.kinematics.a_m)
    assert one.camera.left == two.camera.left


def test_streams_are_independent_of_each_other():
    first = rng_for(1, "dh_length").standard_normal(4)
    assert not np.array_equal(first, rng_for(1, "joint_zero").standard_normal(4))
    assert not np.array_equal(first, rng_for(2, "dh_length").standard_normal(4))


@pytest.mark.parametrize("preset", PRESET_NAMES)
def test_the_start_is_as_the_preset_says(worlds, preset):
    for world in worlds[preset]:
        T_base_tcp = Plant(world.plant, world.q_start_rad).T_base_tcp()
        T_ooi_tool = inverse_pose(world.scene.T_base_ooi) @ T_base_tcp @ world.scene.T_tcp_tool
        x, y, z = T_ooi_tool[:3, 3]
        assert 0.6 <= z <= 0.9  # m
        assert np.hypot(x, y) <= 0.15  # m
        assert np.abs(np.rad2deg(rotvec_from_rotation(T_ooi_tool[:3, :3]))).max() < 9.0  # deg; 8 per elementary turn
        assert abs(np.rad2deg(world.q_start_rad[0])) <= 40.0
        assert 20.0 <= abs(np.rad2deg(world.q_start_rad[4])) <= 90.0
        assert all_in_view(world.camera, world.scene, T_ooi_tool, 30.0)
        goal = np.eye(4)
        goal[2, 3] = 0.1
        assert all_in_view(world.camera, world.scene, goal, 10.0)
        assert wall_clearance(world.scene, tool_stations(T_ooi_tool, goal)) >= 0.05  # m


def test_ideal_world_is_exactly_nominal(worlds, nominal):
    for world in worlds["ideal"]:
        assert world.camera.left == world.camera.right == nominal.camera
        assert np.allclose(world.camera.T_tcp_cam_left, nominal.T_tcp_cam_left, atol=1e-15)
        assert world.scene.ooi_markers[0].side_m == 0.15
        assert world.plant.rigid


def test_paper_mount_is_five_degrees_about_camera_x(worlds, nominal):
    for world in worlds["paper"]:
        R = nominal.T_tcp_cam_left[:3, :3].T @ world.camera.T_tcp_cam_left[:3, :3]
        assert np.rad2deg(geodesic_angle(np.eye(3), R)) == pytest.approx(5.0)
        assert abs(rotvec_from_rotation(R)[0]) == pytest.approx(np.deg2rad(5.0))


def test_realistic_mounts_and_eyes_differ_from_nominal(worlds, nominal):
    for world in worlds["realistic"]:
        assert world.camera.left.fx_px != nominal.camera.fx_px
        assert world.camera.left.cx_px != world.camera.right.cx_px
        assert world.camera.left.cy_px == world.camera.right.cy_px
        assert 0.0 <= world.camera.clock_offset_s <= 0.15


def test_a_scene_out_of_reach_is_refused(worlds, nominal):
    world = worlds["realistic"][0]
    T_base_tcp = Plant(world.plant, world.q_start_rad).T_base_tcp()
    assert scene_fault(nominal, world.q_start_rad, T_base_tcp, world.scene, world.camera) is None
    stretched = np.deg2rad([0.0, 5.0, -15.0, 0.0, -20.0, 0.0])
    shifted = T_base_tcp.copy()
    reason = scene_fault(nominal, stretched, shifted, world.scene, world.camera)
    assert reason is not None
