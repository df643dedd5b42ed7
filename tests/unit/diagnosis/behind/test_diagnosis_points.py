"""Points by a tracker and poses by the camera: recordings with only part of the chain."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_cases import MACHINE, MACHINE_TOML
from static_points import ARM, NOISE_M, TRACKER, examined, packed, static_recording

from diagnosis.answer import answer_json
from diagnosis.behind.points import fit_points, rigid_fit, static_data
from diagnosis.behind.views import triangulated, views_of
from diagnosis.budget import budget_of
from diagnosis.errors import DiagnosisError
from diagnosis.localise import localise, merged_stages
from diagnosis.log.nominal import nominal_of
from diagnosis.reading.read import stages_present
from machine.camera import project_stereo
from machine.effects.layout import ParameterSets, neutral_sets
from machine.effects.seen import camera_mount, seen_corners
from machine.effects.structure import tcp_poses
from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from recording.content import Recording
from recording.rows import NAN, MarkerCorners, PlcState, Row
from recording.run import RunInfo, Segment


def test_static_poses_alone_are_enough_for_the_structure() -> None:
    whole = examined(static_recording(neutral_sets(6)))
    assert whole.findings == ()
    assert stages_present(whole) == ("structure",)
    found = localise(whole)
    assert {place.stage for place in found.gap_places} == {"structure"}
    assert max(place.model_gap for place in found.gap_places) == pytest.approx(NOISE_M, rel=0.25)
    assert merged_stages(whole)[-1][0] == ("joint", "structure")


def test_a_log_of_which_nothing_is_replayed_is_said_beside_what_is_judged() -> None:
    made = static_recording(neutral_sets(6))
    assert not examined(made).log_unused
    signals = [(0.1 * float(np.sin(0.01 * k)),) * 6 for k in range(2000)]
    still = (0.0,) * 6
    asked = [signals[0], *signals[:-1]]  # who writes one column twice is told so
    log = tuple(PlcState(0.005 * k, 0, q, (), asked[k], still, (), (), NAN, NAN) for k, q in enumerate(signals))
    with_log = replace(made, rows=(*made.rows, *log))
    assert not examined(with_log).log_unused
    elsewhere = replace(with_log, run_info=replace(made.run_info, segments=(Segment("late", "steps", 50.0, 60.0),)))
    whole = examined(elsewhere)
    assert whole.has_judgeable_stage
    assert whole.log_unused
    assert "PLC's log" in {missing["signal"] for missing in answer_json(budget_of(whole))["missing"]}


def test_a_long_link_and_a_soft_one_are_seen_in_static_poses() -> None:
    for sets in (packed("link_length_error", 2, error_m=0.02), packed("gravity_sag", 2, compliance_rad_nm=1e-6)):
        gaps = [place.model_gap for place in localise(examined(static_recording(sets))).gap_places]
        assert np.linalg.norm(gaps) > 3e-3


def test_unknown_places_and_frame_are_found_and_the_true_effect_leaves_the_noise() -> None:
    free = MACHINE_TOML + "\n[points]\ntip = { joint = 6 }\nelbow = { joint = 2 }\n"
    sets = packed("gravity_sag", 2, compliance_rad_nm=1e-6)
    whole = examined(static_recording(sets, free))
    assert whole.nominal_machine is not None
    assert whole.tables is not None
    assert whole.tables.static is not None
    data = static_data(whole.nominal_machine, whole.tables.static)
    assert data is not None
    right, wrong = (
        fit_points(whole.nominal_machine, sets, data),
        fit_points(whole.nominal_machine, neutral_sets(6), data),
    )
    assert np.sqrt(np.mean(right.residual_m**2)) == pytest.approx(NOISE_M, rel=0.2)
    assert np.sqrt(np.mean(wrong.residual_m**2)) > 5.0 * NOISE_M
    assert right.positions_in_link_m == pytest.approx(np.array([[0.0, -0.3, 0.1], [0.1, 0.2, 0.0]]), abs=2e-3)
    assert right.T_base_tracker @ TRACKER == pytest.approx(np.eye(4), abs=2e-3)


def test_points_without_geometry_or_names_are_named() -> None:
    whole = examined(static_recording(neutral_sets(6), MACHINE_TOML))
    assert any("points ['elbow', 'tip'] are not in [points]" in str(finding) for finding in whole.findings)
    with pytest.raises(DiagnosisError, match="joint = 0"):
        nominal_of(MACHINE_TOML + "\n[points]\ntip = { joint = 9, xyz_m = [0, 0, 0] }\n")


def test_rigid_fit_is_exact_and_never_mirrors() -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(8, 3))
    assert rigid_fit(points, points @ TRACKER[:3, :3].T + TRACKER[:3, 3]) == pytest.approx(TRACKER, abs=1e-12)
    assert np.linalg.det(rigid_fit(points, points * [1.0, 1.0, -1.0])[:3, :3]) == pytest.approx(1.0)


# ------------------------------------------------------------------ camera

T_TOOL = np.linalg.inv(MACHINE.T_tcp_cam_left) @ MACHINE.T_tcp_tool


def camera_recording(sets: ParameterSets, with_plc: bool = True) -> Recording:
    """A slow motion in front of the OOI, 200 pairs, corners without noise."""
    t = np.arange(200) * 0.1
    q = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4]) + 0.05 * np.sin(
        t[:, None] * np.array([0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
    )
    T_base_cam = tcp_poses(ARM, sets, q) @ camera_mount(sets, MACHINE.T_tcp_cam_left)
    T_first = tcp_poses(ARM, neutral_sets(6), q[:1])[0] @ MACHINE.T_tcp_cam_left
    T_cam_ooi = pose(rotation_from_rotvec(np.array([np.pi, 0.0, 0.0])), np.array([0.0, 0.0, 0.8]))
    Ts_cam_ooi = np.linalg.inv(T_base_cam) @ (T_first @ T_cam_ooi)
    T_cam_tool = np.linalg.inv(camera_mount(sets, MACHINE.T_tcp_cam_left)) @ MACHINE.T_tcp_tool
    rows: list[Row] = []
    for on, Ts in (("ooi", Ts_cam_ooi), ("tool", np.tile(T_cam_tool, (len(t), 1, 1)))):
        markers = tuple(marker for marker in MACHINE.markers if marker.on == on)
        seen = seen_corners(sets, MACHINE.camera, markers, Ts)
        for eye, pixels in (("left", seen.left_px), ("right", seen.right_px)):
            for k in range(len(t)):
                rows += [
                    MarkerCorners(float(t[k]), eye, marker.marker_id, *pixels[k, m].ravel().tolist())
                    for m, marker in enumerate(markers)
                ]
    if with_plc:
        rows += [
            PlcState(float(t[k]), k, (), (), tuple(q[k].tolist()), (), (), (), float("nan"), float("nan"))
            for k in range(len(t))
        ]
    segments = (Segment("look", "static", 0.0, 19.9),) if with_plc else ()
    return Recording("folder", RunInfo("camera", "", None, 0.0, 0.0, None, segments), MACHINE_TOML, tuple(rows))


def camera_gaps(sets: ParameterSets, with_plc: bool = True) -> dict[tuple[str, str], float]:
    whole = examined(camera_recording(sets, with_plc))
    assert whole.has_judgeable_stage, [str(finding) for finding in whole.findings]
    return {
        (place.motion_regime, place.axis or ""): place.model_gap
        for place in localise(whole).gap_places
        if place.stage == "camera"
    }


def test_without_effects_tool_and_ooi_are_where_they_belong() -> None:
    gaps = camera_gaps(neutral_sets(6))
    assert len(gaps) == 12
    assert max(gaps.values()) < 1e-6


def test_the_camera_alone_sees_its_mount_by_the_tool_marker() -> None:
    gaps = camera_gaps(packed("hand_eye_translation", None, distance_m=0.02, direction=[1.0, 0.0, 0.0]), with_plc=False)
    assert np.linalg.norm([gaps["tool marker", axis] for axis in "xyz"]) == pytest.approx(0.02, rel=1e-3)
    assert ("ooi", "x") not in gaps


def test_a_wrong_focal_length_and_a_soft_boom_are_gaps_behind_the_encoders() -> None:
    for sets in (packed("focal_length_error", None, scale_frac=0.02), packed("encoder_scale", 2, scale_frac=0.0)):
        gaps = camera_gaps(sets)
        expected = sets.machine_parameters.any() and sets.machine_parameters[0, 10] != 0.0
        assert (np.linalg.norm([gaps["ooi", axis] for axis in "xyz"]) > 1e-4) == expected
    tilted = camera_gaps(packed("joint_axis_tilt", 2, tilt_rad=0.05, about="x"))
    assert np.linalg.norm([tilted["ooi", axis] for axis in "xyz"]) > 1e-4


def test_triangulation_returns_the_points() -> None:
    points = np.array([[0.1, -0.05, 0.7], [-0.2, 0.1, 1.4]])
    assert triangulated(MACHINE.camera, *project_stereo(MACHINE.camera, points)) == pytest.approx(points, abs=1e-9)
    left, _ = project_stereo(MACHINE.camera, points)
    assert np.isnan(triangulated(MACHINE.camera, left, left)).all()


def test_one_eye_gives_no_view() -> None:
    made = camera_recording(neutral_sets(6))
    left = replace(
        made, rows=tuple(row for row in made.rows if not (isinstance(row, MarkerCorners) and row.eye == "right"))
    )
    whole = examined(left)
    assert whole.nominal_machine is not None
    assert whole.tables is not None
    assert whole.tables.markers is not None
    assert len(views_of(whole.nominal_machine, whole.tables.markers, "ooi").t_s) == 0
