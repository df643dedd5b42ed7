"""A calibration path is driven as slowly as the camera's rate needs, or refused before it begins."""

from dataclasses import replace

import numpy as np
import pytest
from motion_scenes import chain, machine, posture
from test_motion_point_to_point import assert_obeys_limits

from machine.kinematics import tcp_poses
from server.motion.calibration_paths import plan_calibration_path
from server.motion.camera_pace import CameraNeeds, camera_paced
from server.motion.contracts import PlanStatus, sample_trajectory

NEEDS = CameraNeeds(shift_max_px=4.0, focal_px=700.0, depth_m=0.8, chord_m=0.08, chords_min=12)


@pytest.fixture(scope="module")
def plan():
    found = plan_calibration_path(machine(), posture(0))
    assert found.status is PlanStatus.OK, found.reason
    return found


def unforeseen_px(plan, pair_s):
    """By how much a point at the depth is off the place that constant speed predicts, at the worst pair [px]."""
    t_s, motion = sample_trajectory(plan.trajectory, pair_s)
    places = tcp_poses(chain(), motion.q)[:, :3, 3]
    off_m = np.linalg.norm(places[2:] - 2.0 * places[1:-1] + places[:-2], axis=1)
    return float(off_m.max()) * NEEDS.focal_px / NEEDS.depth_m * (pair_s / (t_s[1] - t_s[0])) ** 2


def test_a_fast_camera_slows_nothing(plan):
    assert camera_paced(machine(), plan, 1.0 / 15.0, NEEDS) is plan


@pytest.mark.parametrize("pair_s", [0.2, 0.33, 0.5])
def test_a_slow_camera_slows_the_path_by_what_it_needs_and_no_more(plan, pair_s):
    paced = camera_paced(machine(), plan, pair_s, NEEDS)
    assert paced.status is PlanStatus.OK
    assert paced.duration_s > plan.duration_s
    assert paced.duration_s == pytest.approx(paced.trajectory.duration_s)
    assert paced.tcp_speed_max_m_s < plan.tcp_speed_max_m_s
    np.testing.assert_allclose(paced.trajectory.q[[0, -1]], plan.trajectory.q[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(paced.trajectory.qd[[0, -1]], 0.0, atol=1e-9)
    assert np.diff(paced.trajectory.t_s).max() < 0.2  # s, what the PLC takes
    assert_obeys_limits(paced.trajectory, 1.3)
    assert unforeseen_px(paced, pair_s) <= NEEDS.shift_max_px < unforeseen_px(plan, pair_s)
    longer = paced.duration_s / plan.duration_s
    shares = np.linspace(0.0, 1.0, 50)
    there, here = (
        np.array([np.interp(shares * one.duration_s, one.trajectory.t_s, q) for q in one.trajectory.q.T])
        for one in (plan, paced)
    )
    np.testing.assert_allclose(here, there, atol=1e-3)  # rad: the same way
    assert longer == pytest.approx(pair_s / camera_limit_s(plan), rel=0.01)


def camera_limit_s(plan):
    """The longest interval at which nothing is slowed."""
    low, high = 0.01, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if camera_paced(machine(), plan, middle, NEEDS) is plan else (low, middle)
    return low


def test_enough_chords_are_part_of_what_it_needs(plan):
    needs = replace(NEEDS, shift_max_px=1e6, chords_min=60)
    paced = camera_paced(machine(), plan, 0.5, needs)
    begun = (1.0 - needs.chord_m / plan.length_m) * paced.duration_s / 0.5
    assert begun == pytest.approx(60.0, abs=0.1)
    assert camera_paced(machine(), plan, 0.1, needs) is plan


def test_what_would_take_too_long_is_refused_with_the_rate_it_needs(plan):
    refused = camera_paced(machine(), plan, 3.0, NEEDS)
    assert refused.status is PlanStatus.TOO_FAST
    assert refused.trajectory is None
    assert "a pair every 3.00 s" in refused.reason
    assert "limit 120 s" in refused.reason
    assert "relieve the computer" in refused.reason
    assert camera_paced(machine(), refused, 0.1, NEEDS) is refused
