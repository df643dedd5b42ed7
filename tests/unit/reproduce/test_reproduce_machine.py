"""The fast machine beside the fine plant: the same sag, the same rests; and the camera beside exact geometry."""

import numpy as np
import pytest
from reproduce_worlds import NO_NOISE, NOISE, machine, world

from benchmarks.reproduce.fast_camera import FastCamera, Source
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.fine_machine import FineMachine
from benchmarks.reproduce.true_corners import TrueView, true_poses_cam
from machine.rotations import geodesic_angle
from server.motion.point_to_point import plan_joint_move
from server.vision.contracts import LookStatus, PoseStatus
from sim_plc.plant.plant import Plant
from sim_plc.world import rng_for

SOURCES: tuple[Source, ...] = ("stereo", "mono")


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("preset", ["ideal", "realistic"])
def test_at_the_start_it_stands_where_the_plant_stands(preset, seed):
    one = world(preset, seed)
    fast = QuasiStaticMachine(one)
    np.testing.assert_allclose(fast.T_base_tcp(), Plant(one.plant, one.q_start_rad).T_base_tcp(), atol=1e-7)
    np.testing.assert_allclose(fast.q_encoder, one.q_start_rad, atol=1.3e-5)


def test_it_rests_where_the_fine_plant_rests():
    """A joint move of about 8 deg: encoders agree to 0.06 deg (lift: friction), the tool to 4 mm, stall to a third."""
    one = world("realistic", 2)
    fast, fine = QuasiStaticMachine(one), FineMachine(one)
    goal = fast.q_encoder + np.deg2rad([5.0, 2.0, -4.0, 3.0, 8.0, -3.0])
    plan = plan_joint_move(machine(), fast.q_encoder, goal)
    assert plan.trajectory is not None
    for each in (fast, fine):
        each.play(plan.trajectory)
        each.settle()
    apart = np.rad2deg(np.abs(fast.q_encoder - fine.q_encoder))
    assert apart.max() < 0.06
    assert np.delete(apart, 1).max() < 0.03
    assert np.linalg.norm((fast.T_base_tcp() - fine.T_base_tcp())[:3, 3]) < 0.004
    stalled = np.abs(fast.q_ref - fast.q_encoder)
    expected = (one.plant.valve.dead_band_frac - one.plant.valve.hysteresis_frac) / [
        joint.kp_frac_per_rad for joint in machine().joints
    ]
    np.testing.assert_allclose(stalled, expected, rtol=0.1, atol=1e-4)


def test_the_trace_is_what_the_plc_would_have_sent():
    one = world("realistic", 1)
    fast = QuasiStaticMachine(one)
    plan = plan_joint_move(machine(), fast.q_encoder, fast.q_encoder + 0.05)
    assert plan.trajectory is not None
    fast.play(plan.trajectory)
    fast.settle()
    trace = fast.trace(0.0)
    np.testing.assert_allclose(np.diff(trace.t_s), 0.010, atol=1e-9)
    np.testing.assert_allclose(trace.q_encoder[-1], fast.q_encoder, atol=1e-9)
    np.testing.assert_allclose(trace.Ts_base_tcp[-1], fast.T_base_tcp(), atol=5e-6)
    assert len(fast.trace(fast.t_s + 1.0).t_s) == 0
    counts = trace.q_encoder * 262144 / (2 * np.pi)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_an_ideal_camera_without_noise_sees_the_truth():
    one = world("ideal", 1)
    T = QuasiStaticMachine(one).T_base_tcp()
    camera = FastCamera(one, NO_NOISE, rng_for(1, "test"))
    for source in SOURCES:
        look = camera.look(T, 5, source, 1.0)
        assert look.status is LookStatus.OK
        for found, true in zip((look.T_cam_tool, look.T_cam_ooi), true_poses_cam(one, T), strict=True):
            assert found is not None
            np.testing.assert_allclose(found, true, atol=2e-5)


def test_a_real_camera_errs_by_its_lens_and_a_noisy_one_differs_from_look_to_look():
    one = world("realistic", 3)
    T = QuasiStaticMachine(one).T_base_tcp()
    camera = FastCamera(one, NOISE, rng_for(1, "test"))
    first, second = (camera.pair(T, "stereo", 0).ooi.T_cam_object for _ in range(2))
    assert first is not None
    assert second is not None
    assert 0.0 < np.linalg.norm((first - second)[:3, 3]) < 0.004
    assert geodesic_angle(first[:3, :3], true_poses_cam(one, T)[1][:3, :3]) < np.deg2rad(1.0)
    tools = [camera.pair(T, "stereo", 0, frame_share=0.0).tool.T_cam_object for _ in range(2)]
    assert tools[0] is not None
    assert tools[1] is not None
    np.testing.assert_allclose(tools[0], tools[1], atol=1e-12)  # the tool stands still in the image


def test_what_the_tool_hides_is_not_seen():
    one = world("realistic", 3)
    T = QuasiStaticMachine(one).T_base_tcp()
    view = TrueView(one)
    seen = {marker.marker_id: marker for marker in view.corners(T)}
    away = T.copy()
    away[:3, 3] += 5.0 * T[:3, 0]
    camera = FastCamera(one, NO_NOISE, rng_for(1, "test"))
    assert seen[10].left_px is not None
    assert sum(one.left_px is not None for one in seen.values()) >= 2
    assert camera.pair(away, "stereo", 0).ooi.status is PoseStatus.NOT_SEEN
    assert camera.pair(away, "stereo", 0).tool.status is PoseStatus.OK
