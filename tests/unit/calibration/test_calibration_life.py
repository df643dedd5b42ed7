"""The life of a calibration: where it holds, what ends it, what a slip is, and the file that outlives the server."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from machine.poses import pose
from machine.rotations import rotation_from_quat_wxyz, rotation_from_rotvec
from server.calibration.calibration_export import as_ros, as_yaml
from server.calibration.calibration_file import (
    CalibrationFileError,
    SavedCalibration,
    calibration_text,
    parse_calibration,
)
from server.calibration.calibration_life import LocalCalibration, LocalMap, MadeAt, ValidityStatus, observability_text
from server.calibration.contracts import CameraTrack
from server.calibration.joint_observations import JointTrack, OdometryRun
from server.calibration.slip_monitor import ToolSeen, judge_slip

Q = np.deg2rad([10.0, 42.0, -85.0, 4.0, -43.0, 3.0])
T_MADE = pose(rotation_from_rotvec(np.array([0.1, -0.2, 0.3])), np.array([2.0, 0.5, 1.5]))
T_CAM_TOOL = pose(rotation_from_rotvec(np.array([3.0, 0.1, 0.0])), np.array([0.02, 0.10, 0.45]))
COVARIANCE = np.diag([2e-3, 2e-3, 5e-4, 1e-4, 1e-4, 5e-4]) ** 2
MADE_S = 1_800_000_000.0


def calibration(**changed) -> LocalCalibration:
    one = LocalCalibration(
        machine_id="0123456789abcdef",
        method="chords",
        R_tcp_cam=rotation_from_rotvec(np.array([3.1, 0.02, -0.03])),
        covariance=np.diag(np.deg2rad([0.2, 0.5, 0.1])) ** 2,
        p_tcp_cam_m=np.array([0.0, -0.12, 0.10]),
        from_nominal_deg=2.5,
        time_offset_s=-0.062,
        residual_rms_mm=0.8,
        residual_max_mm=2.1,
        n_used=61,
        path_length_m=1.02,
        observability=0.2,
        made_at=MadeAt(MADE_S, Q, T_MADE, 40.0),
        tool_marker_pose=ToolSeen(T_CAM_TOOL, COVARIANCE),
    )
    return replace(one, **changed)


def at(one, hours=0.1, shift=(0.0, 0.0, 0.0), turn_deg=0.0, joint_deg=0.0, oil=41.0):
    T = T_MADE @ pose(rotation_from_rotvec(np.deg2rad([0.0, turn_deg, 0.0])), np.zeros(3))
    T[:3, 3] = T_MADE[:3, 3] + shift
    q = Q + np.deg2rad([0.0, 0.0, joint_deg, 0.0, 0.0, 0.0])
    return one.valid_at(MADE_S + 3600.0 * hours, q, T, oil)


@pytest.mark.parametrize(
    ("status", "inside", "outside", "word"),
    [
        ("TOO_OLD", {"hours": 11.9}, {"hours": 12.1}, "12.1 h old"),
        ("CLOCK", {"hours": -0.01}, {"hours": -0.1}, "future"),
        ("TOO_FAR", {"shift": (0.0, 0.99, 0.0)}, {"shift": (0.0, 1.01, 0.0)}, "1.01 m"),
        ("TURNED", {"turn_deg": 29.0}, {"turn_deg": 31.0}, "31 deg"),
        ("POSTURE", {"joint_deg": -59.0}, {"joint_deg": -61.0}, "61 deg"),
        ("TEMPERATURE", {"oil": 64.0}, {"oil": 66.0}, "+26 K"),
        ("TEMPERATURE", {"oil": 16.0}, {"oil": 14.0}, "-26 K"),
    ],
)
def test_each_bound_holds_on_both_sides_and_says_what_to_do(status, inside, outside, word):
    one = calibration()
    assert at(one, **inside).ok
    found = at(one, **outside)
    assert found.status is ValidityStatus[status]
    assert word in found.reason
    assert "calibrate" in found.reason


def test_a_machine_that_tells_no_temperature_is_not_judged_by_it():
    assert at(calibration(), oil=None).ok
    assert at(calibration(made_at=MadeAt(MADE_S, Q, T_MADE, None)), oil=80.0).ok


def test_a_slip_ends_it_wherever_the_machine_is():
    found = at(calibration(slip="mount or marker slipped"))
    assert found.status is ValidityStatus.SLIPPED
    assert "slipped" in found.reason


def moved(shift_mm=(0.0, 0.0, 0.0), turn_deg=(0.0, 0.0, 0.0), covariance=COVARIANCE):
    T = T_CAM_TOOL.copy()
    T[:3, :3] = rotation_from_rotvec(np.deg2rad(turn_deg)) @ T[:3, :3]
    T[:3, 3] += np.array(shift_mm) * 1e-3
    return ToolSeen(T, covariance)


def test_a_shift_ends_it_until_it_is_made_anew():
    found = at(calibration(shift="a little"))
    assert found.status is ValidityStatus.SHIFTED
    text = calibration_text(SavedCalibration(calibration(shift="a little")))
    assert parse_calibration(text).calibration.shift == "a little"
    before = json.loads(text)
    del before["shift"]
    assert parse_calibration(json.dumps(before)).calibration.shift == ""


def test_noise_is_no_slip():
    rng = np.random.default_rng(4)
    before = ToolSeen(T_CAM_TOOL, COVARIANCE)
    for _ in range(500):
        noise = rng.multivariate_normal(np.zeros(6), 2.0 * COVARIANCE)
        now = moved(shift_mm=noise[3:] * 1e3, turn_deg=np.rad2deg(noise[:3]))
        verdict = judge_slip(before, now)
        assert not verdict.slipped
        assert not verdict.shifted


@pytest.mark.parametrize("change", [{"shift_mm": (3.5, 0.0, 0.0)}, {"turn_deg": (0.0, 0.0, 1.5)}])
def test_a_change_beyond_noise_and_minimum_is_a_slip(change):
    verdict = judge_slip(ToolSeen(T_CAM_TOOL, COVARIANCE), moved(**change))
    assert verdict.slipped
    assert "slipped" in verdict.reason
    assert "calibrate" in verdict.reason


def test_a_sure_but_small_change_and_a_large_but_unsure_one_are_no_slips():
    small = judge_slip(ToolSeen(T_CAM_TOOL, COVARIANCE * 1e-4), moved(shift_mm=(2.9, 0.0, 0.0)))
    assert small.chi2 > 50.0
    assert not small.slipped
    assert small.shifted, "of another mount all the same: the path is driven again"
    assert "2.9 mm" in small.reason
    unsure = judge_slip(
        ToolSeen(T_CAM_TOOL, COVARIANCE), moved(shift_mm=(0.0, 0.0, 6.0), covariance=COVARIANCE * 100.0)
    )
    assert unsure.shift_m == pytest.approx(0.006)
    assert not unsure.slipped
    assert not unsure.shifted


def run() -> OdometryRun:
    t = np.arange(0.0, 2.0, 0.01)
    Ts = np.tile(np.eye(4), (20, 1, 1))
    Ts[:, 0, 3] = np.linspace(0.0, 0.3, 20)
    qs = Q + 0.1 * np.sin(t)[:, None]
    return OdometryRun(CameraTrack(np.linspace(0.0, 1.9, 20), Ts), JointTrack(t, qs, np.sign(qs)))


def test_what_is_written_is_read_back_equal():
    found = LocalMap(T_MADE, T_CAM_TOOL, np.array([1e-3, -2e-4]), 1.002, 0.9, 0.4, 60, 2)
    saved = SavedCalibration(calibration(local_map=found, slip="x"), (run(),))
    back = parse_calibration(calibration_text(saved))
    np.testing.assert_array_equal(back.calibration.R_tcp_cam, saved.calibration.R_tcp_cam)
    np.testing.assert_array_equal(back.calibration.covariance, saved.calibration.covariance)
    np.testing.assert_array_equal(back.calibration.made_at.T_base_tcp, T_MADE)
    np.testing.assert_array_equal(back.calibration.local_map.errors, found.errors)
    np.testing.assert_array_equal(back.calibration.tool_marker_pose.covariance, COVARIANCE)
    plain = ("machine_id", "method", "time_offset_s", "n_used", "slip", "expiry", "from_nominal_deg")
    assert all(getattr(back.calibration, name) == getattr(saved.calibration, name) for name in plain)
    assert calibration_text(parse_calibration(calibration_text(saved))) == calibration_text(back)


def test_a_kept_run_gives_the_same_joints_at_the_camera_s_times():
    kept = parse_calibration(calibration_text(SavedCalibration(calibration(), (run(),)))).odometry_runs[0]
    assert len(kept.joint_track.t_s) < len(run().joint_track.t_s)
    there, _ = kept.joint_track.joints_at(kept.camera_track.t_s)
    before, _ = run().joint_track.joints_at(run().camera_track.t_s)
    assert np.abs(there - before).max() < 3e-5
    np.testing.assert_allclose(kept.camera_track.Ts_vo_cam, run().camera_track.Ts_vo_cam, atol=1e-9)


EMPTY_RUN = {"camera_t_s": [], "Ts_vo_cam": [], "joints_t_s": [], "qs_rad": [], "sides": None}


def broken(**changed):
    body = json.loads(calibration_text(SavedCalibration(calibration(), (run(),))))
    body.update(changed)
    return json.dumps(body)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "damaged"),
        ("{", "damaged"),
        ("[]", "not a 'longreach"),
        ("{}", "not a 'longreach"),
        (broken(version=0), "version 0"),
        (broken(version=2), "version 2"),
        (broken(version="1"), "version '1'"),
        (broken(surprise=1), "surprise"),
        (broken(n_used="many"), "n_used"),
        (broken(R_tcp_cam=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "mirrored"),
        (broken(R_tcp_cam=[[1, 0], [0, 1]]), "shape"),
        (broken(R_tcp_cam=[[1, 0, 0], [0, 1], [0, 0, 1]]), "calibrate again"),
        (broken(covariance_rad2=[[-1, 0, 0], [0, 1, 0], [0, 0, 1]]), "positive"),
        (broken(p_tcp_cam_m=[0.0]), "p_tcp_cam_m"),
        (
            broken(runs=[{"camera_t_s": [0.0], "Ts_vo_cam": [], "joints_t_s": [], "qs_rad": [], "sides": None}]),
            "do not fit",
        ),
        (broken().replace('"n_used": 61', '"n_used": NaN'), "n_used"),
    ],
)
def test_anything_else_is_a_clear_error(text, word):
    with pytest.raises(CalibrationFileError, match=word):
        parse_calibration(text)


def test_every_cut_of_a_file_is_a_clear_error():
    text = broken()
    for length in range(0, len(text) - 1, 97):
        with pytest.raises(CalibrationFileError):
            parse_calibration(text[:length])


def test_exports_hold_the_mount():
    one = calibration()
    body = yaml.safe_load(as_yaml(one, at(one)))
    assert body["valid"] is True
    np.testing.assert_allclose(
        rotation_from_quat_wxyz(np.array(body["T_tcp_cam_left"]["quat_wxyz"])), one.R_tcp_cam, atol=1e-7
    )
    assert body["T_tcp_cam_left"]["translation_m"] == [0.0, -0.12, 0.1]
    text = as_ros(one, at(one, hours=20.0))
    assert text.startswith("# EXPIRED")
    ros = yaml.safe_load(text)["transforms"][0]
    turn = ros["transform"]["rotation"]
    R = rotation_from_quat_wxyz(np.array([turn["w"], turn["x"], turn["y"], turn["z"]]))
    np.testing.assert_allclose(R, one.R_tcp_cam, atol=1e-7)
    assert (ros["header"]["frame_id"], ros["child_frame_id"]) == ("tcp", "cam_left")
    assert ros["header"]["stamp"] == {"sec": int(MADE_S), "nanosec": 0}


def test_the_weakest_axis_is_named():
    assert "weakest about y of the TCP, 0.50 deg" in observability_text(calibration())
    assert "nearly a straight line" in observability_text(calibration(observability=0.003))
