"""Looks: robust mean, rest, and failures that say what to do; and the error to the goal."""

from dataclasses import replace

import numpy as np
import pytest
from vision_scenes import deviation, facing_pose

from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from server.vision.contracts import LookStatus, ObjectPose, PairObservation, PoseStatus
from server.vision.errors import NoPoseError
from server.vision.goal_error import error_to_goal, pair_error, pose_error
from server.vision.look import average_look
from server.vision.object_pose import not_seen

SIGMA = np.diag([2e-3] * 3 + [2e-4] * 3)
TOOL, OOI = facing_pose(0.5, 10.0, 20.0, (-0.06, 0.18)), facing_pose(1.1, 4.0, 50.0)
GOAL = pose(np.eye(3), np.array([0.0, 0.0, 0.1]))


def disturbed(T, rng, scale=1.0):
    noise = SIGMA @ rng.normal(size=6) * scale
    return pose(rotation_from_rotvec(noise[:3]) @ T[:3, :3], T[:3, 3] + noise[3:])


def found_at(on, T, status=PoseStatus.OK):
    return ObjectPose(on, status, "" if status is PoseStatus.OK else "why", T, SIGMA @ SIGMA, (1,), 0.1, 50.0)


def pairs(n=20, seed=1, drift_m=0.0, status=PoseStatus.OK):
    rng = np.random.default_rng(seed)
    observations = []
    for k in range(n):
        tool = disturbed(TOOL, rng)
        tool[0, 3] += drift_m * k / n
        ooi = disturbed(OOI, rng)
        observations.append(PairObservation(k * 1000, found_at("tool", tool, status), found_at("ooi", ooi), (), ()))
    return observations


def test_the_mean_is_better_than_one_pair_and_says_how_much():
    squares = []
    for seed in range(60):
        look = average_look(pairs(seed=seed))
        assert look.status is LookStatus.OK
        assert look.n_pairs == 20
        assert look.n_used >= 15
        assert (look.t_first_ns, look.t_last_ns) == (0, 19000)
        error = deviation(look.T_cam_tool, TOOL)
        squares.append(error @ np.linalg.solve(look.tool_covariance, error))
        assert np.linalg.norm(error[3:]) < 3e-4, "m"
    assert 3.0 < np.mean(squares) < 7.0, "chi2 of 6 degrees of freedom has mean 6"


def test_outliers_are_cut():
    observations = pairs()
    flipped = found_at("tool", pose(rotation_from_rotvec(np.array([0.5, 0, 0])) @ TOOL[:3, :3], TOOL[:3, 3] + 0.01))
    for k in (3, 9, 15):
        observations[k] = replace(observations[k], tool=flipped)
    look = average_look(observations)
    assert look.status is LookStatus.OK
    assert look.n_used <= 17
    assert np.abs(deviation(look.T_cam_tool, TOOL)).max() < 2e-3


def test_motion_is_not_rest():
    look = average_look(pairs(drift_m=0.004), spread_max_mm=1.0)
    assert look.status is LookStatus.NOT_AT_REST
    assert "wait" in look.reason
    assert look.T_cam_tool is None
    assert look.spread_mm > 0.2


def test_swinging_is_not_rest():
    observations = pairs()
    for k, one in enumerate(observations):
        T = one.tool.T_cam_object.copy()
        T[1, 3] += 0.004 * np.sin(1.7 * k)
        observations[k] = replace(one, tool=found_at("tool", T))
    assert average_look(observations).status is LookStatus.NOT_AT_REST


@pytest.mark.parametrize(("on", "status"), [("tool", LookStatus.TOOL_NOT_SEEN), ("ooi", LookStatus.OOI_NOT_SEEN)])
def test_what_is_not_seen_is_named(on, status):
    observations = [replace(one, **{on: not_seen(on, f"no marker of the {on}")}) for one in pairs()]
    look = average_look(observations)
    assert look.status is status
    assert on in look.reason
    assert look.T_cam_ooi is None


def test_no_pairs_is_no_images():
    look = average_look([])
    assert look.status is LookStatus.NO_IMAGES
    assert "camera" in look.reason


def test_rejected_poses_give_their_reason():
    bad = ObjectPose("tool", PoseStatus.REJECTED, "eyes are swapped", None, None, (10,), 9.0, 0.0)
    look = average_look([replace(one, tool=bad) for one in pairs()])
    assert look.status is LookStatus.REJECTED
    assert "swapped" in look.reason


def test_mostly_ambiguous_pairs_keep_their_position():
    look = average_look(pairs(status=PoseStatus.ORIENTATION_AMBIGUOUS))
    assert look.status is LookStatus.ORIENTATION_AMBIGUOUS
    assert look.reason == "why"
    assert np.abs(deviation(look.T_cam_tool, TOOL)[3:]).max() < 5e-4, "m"


def test_a_single_pair_is_a_look():
    look = average_look(pairs(n=1))
    assert look.status is LookStatus.OK
    assert look.n_used == 1
    assert look.tool_covariance == pytest.approx(SIGMA @ SIGMA)


def test_error_is_tool_minus_goal_in_ooi_axes():
    T_ooi_tool = pose(rotation_from_rotvec(np.deg2rad([1.0, -2.0, 3.0])), np.array([0.010, -0.020, 0.130]))
    error = pose_error(OOI @ T_ooi_tool, OOI, GOAL, np.zeros((6, 6)), np.zeros((6, 6)))
    assert error.position_m == pytest.approx([0.010, -0.020, 0.030], abs=1e-12)
    assert np.rad2deg(error.rotvec_rad) == pytest.approx([1.0, -2.0, 3.0], abs=1e-9)
    assert np.rad2deg(error.angle_rad) == pytest.approx(np.sqrt(14.0), abs=1e-9)
    assert error.distance_m == pytest.approx(np.sqrt(0.01**2 + 0.02**2 + 0.03**2))


def test_goal_reached_is_no_error():
    error = pose_error(OOI @ GOAL, OOI, GOAL, SIGMA @ SIGMA, SIGMA @ SIGMA)
    assert error.distance_m < 1e-12
    assert error.angle_rad < 1e-12
    assert error.sigma_angle_rad == pytest.approx(np.sqrt(2.0) * 2e-3, rel=1e-6)


def test_sigmas_are_those_of_many_draws():
    rng = np.random.default_rng(3)
    T_tool = OOI @ pose(rotation_from_rotvec(np.deg2rad([2.0, 1.0, -1.0])), np.array([0.1, -0.05, 0.4]))
    predicted = pose_error(T_tool, OOI, GOAL, SIGMA @ SIGMA, SIGMA @ SIGMA)
    draws = [
        pose_error(disturbed(T_tool, rng), disturbed(OOI, rng), GOAL, SIGMA @ SIGMA, SIGMA @ SIGMA) for _ in range(1500)
    ]
    spread = np.std([draw.position_m for draw in draws], axis=0)
    assert spread == pytest.approx(predicted.sigma_position_m, rel=0.1)
    turned = np.std([draw.rotvec_rad for draw in draws], axis=0)
    assert turned == pytest.approx(predicted.sigma_rotvec_rad, rel=0.1)


def test_a_failed_look_has_no_error():
    with pytest.raises(NoPoseError, match="look again"):
        error_to_goal(average_look([]), GOAL)
    with pytest.raises(NoPoseError, match="tool"):
        pair_error(not_seen("tool", "gone"), found_at("ooi", OOI), GOAL)


def test_a_good_look_and_its_pairs_agree():
    observations = pairs()
    whole = error_to_goal(average_look(observations), GOAL)
    one = pair_error(observations[0].tool, observations[0].ooi, GOAL)
    expected = (inverse_pose(OOI) @ TOOL)[:3, 3] - GOAL[:3, 3]
    assert whole.position_m == pytest.approx(expected, abs=2e-3)
    assert one.position_m == pytest.approx(expected, abs=1e-2)
    assert (whole.sigma_position_m < one.sigma_position_m).all()
