"""The tool marker's step on views projected from known geometry."""

import dataclasses

import numpy as np
import pytest
from commissioning_states import MACHINE

from machine.camera import project_stereo
from machine.markers import marker_corners
from machine.poses import inverse_pose, transform_points
from server.camera.contracts import FrameReport
from server.commissioning.camera_axes import CameraMove, judge_axes, marker_step
from server.commissioning.contracts import Verdict
from server.commissioning.looking import corners_by_stereo, mean_side_m
from server.commissioning.tool_marker import judge_marker
from server.vision.contracts import MarkerView, ObjectPose, PairObservation, PoseStatus

T_NOMINAL = inverse_pose(MACHINE.T_tcp_cam_left) @ MACHINE.T_tcp_tool
TOOL = MACHINE.markers_on("tool")[0]


def report(T=T_NOMINAL, side_m=TOOL.side_m, marker_id=TOOL.marker_id, swapped=False, seen=True, noise=0.0, seed=0):
    points = transform_points(T, marker_corners(side_m))
    left, right = project_stereo(MACHINE.camera, points)
    rng = np.random.default_rng(seed)
    left, right = left + rng.normal(0.0, noise, left.shape), right + rng.normal(0.0, noise, right.shape)
    left, right = (right, left) if swapped else (left, right)
    views = (MarkerView(marker_id, left, right, 0.1, True, ""),) if seen else ()
    status = PoseStatus.OK if seen and not swapped else PoseStatus.NOT_SEEN
    pose = T if status is PoseStatus.OK else None
    tool = ObjectPose("tool", status, "" if seen else "no marker of the tool", pose, None, (marker_id,), 0.1, 99.0)
    nothing = ObjectPose("ooi", PoseStatus.NOT_SEEN, "", None, None, (), 0.0, 0.0)
    return FrameReport(
        PairObservation(0, tool, nothing, views, ()), 0, 0, 0, "stereo", None, 15.0, 9.0, 0, (), 9.0, None
    )


def looks(**values):
    return [[report(**values, noise=0.05, seed=10 * i + k) for k in range(8)] for i in range(4)]


def figure(result, part):
    return next(each for each in result.figures if part in each.name)


def test_a_marker_where_it_should_be_passes():
    result = judge_marker(looks(), MACHINE)
    assert result.verdict is Verdict.PASS, result.summary
    assert figure(result, "distance by stereo").value == pytest.approx(1e3 * np.linalg.norm(T_NOMINAL[:3, 3]), rel=0.01)
    assert figure(result, "off its nominal place").value < 1.0


def test_stereo_gives_the_side_without_knowing_it():
    left, right = project_stereo(MACHINE.camera, transform_points(T_NOMINAL, marker_corners(0.123)))
    assert mean_side_m(corners_by_stereo(MACHINE.camera, left, right)) == pytest.approx(0.123, rel=1e-6)


@pytest.mark.parametrize(("factor", "verdict"), [(1.02, Verdict.PASS), (0.98, Verdict.PASS), (1.05, Verdict.FAIL)])
def test_a_marker_of_another_size_fails(factor, verdict):
    result = judge_marker(looks(side_m=factor * TOOL.side_m), MACHINE)
    assert result.verdict is verdict
    assert figure(result, "side by stereo").value == pytest.approx(100.0 * abs(factor - 1.0), abs=0.3)


def test_swapped_eyes_fail_by_their_disparity():
    result = judge_marker(looks(swapped=True), MACHINE)
    assert result.verdict is Verdict.FAIL
    assert figure(result, "disparity").value < 0.0


def test_another_id_or_no_marker_fails_and_says_what_is_there():
    other = judge_marker(looks(marker_id=TOOL.marker_id + 1), MACHINE)
    assert other.verdict is Verdict.FAIL
    assert f"markers in view: {TOOL.marker_id + 1}" in other.notes
    none = judge_marker(looks(seen=False), MACHINE)
    assert none.verdict is Verdict.FAIL
    assert "no marker of the tool" in none.summary


def test_a_camera_that_has_been_knocked_fails():
    T = T_NOMINAL.copy()
    T[0, 3] += 0.1
    result = judge_marker(looks(T=T), MACHINE)
    assert result.verdict is Verdict.FAIL
    assert not figure(result, "nominal place").ok


def test_a_marker_that_wobbles_between_looks_fails():
    moved = T_NOMINAL.copy()
    moved[1, 3] += 0.003
    result = judge_marker([*looks(), [report(T=moved)] * 8], MACHINE)
    assert not figure(result, "looks differ in place").ok


# --- camera axes ----------------------------------------------------------------------------------------------------

STEPS = 0.08 * np.diag([1.0, 1.0, -1.0])
LEG_NAMES = ("camera right", "camera down", "camera back")


def legs(turn=None, odometry=True, markers=True):
    turn = np.eye(3) if turn is None else turn
    return [
        CameraMove(name, step, turn @ step if odometry else None, turn @ step if markers else None)
        for name, step in zip(LEG_NAMES, STEPS, strict=True)
    ]


def test_two_witnesses_that_agree_pass_and_one_is_enough():
    assert judge_axes(legs(), [], [90.0]).verdict is Verdict.PASS
    assert judge_axes(legs(markers=False), [], [90.0]).verdict is Verdict.PASS
    assert judge_axes(legs(odometry=False), [], [90.0]).verdict is Verdict.PASS


def test_an_upside_down_camera_fails_and_is_named():
    result = judge_axes(legs(np.diag([-1.0, -1.0, 1.0])), [], [90.0])
    assert result.verdict is Verdict.FAIL
    assert "upside down" in result.summary


@pytest.mark.parametrize(("stretch", "verdict"), [(1.01, Verdict.PASS), (1.04, Verdict.FAIL), (0.96, Verdict.FAIL)])
def test_a_depth_that_is_stretched_alone_is_a_focal_length_that_is_off(stretch, verdict):
    result = judge_axes(legs(np.diag([1.0, 1.0, stretch])), [], [90.0])
    assert result.verdict is verdict
    assert ("focal length" in result.summary) == (verdict is Verdict.FAIL)
    assert judge_axes(legs(1.04 * np.eye(3)), [], [90.0]).verdict is Verdict.PASS, (
        "a scale alike in all axes is not one"
    )


def test_negative_disparity_fails_whatever_else_is_seen():
    assert judge_axes(legs(), [], [-90.0]).verdict is Verdict.FAIL


def test_no_witness_is_no_pass():
    assert judge_axes(legs(odometry=False, markers=False), [], [90.0]).verdict is Verdict.INCONCLUSIVE
    assert judge_axes(legs(), [], []).verdict is Verdict.INCONCLUSIVE
    assert judge_axes(legs()[:2], ["camera back: odometry lost"], [90.0]).verdict is Verdict.INCONCLUSIVE


def test_a_thing_that_stands_still_shows_the_cameras_own_step():
    before, after = np.eye(4), np.eye(4)
    before[:3, 3], after[:3, 3] = (0.0, 0.0, 0.8), (-0.08, 0.0, 0.8)
    assert marker_step(before, after) == pytest.approx([0.08, 0.0, 0.0])
    assert marker_step(None, after) is None


def test_reports_of_these_tests_are_usable():
    assert report().fit_for_look
    assert not dataclasses.replace(report(), warnings=("dark",)).fit_for_look
