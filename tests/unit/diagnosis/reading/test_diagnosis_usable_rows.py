"""A stage is there when rows of it can be used; what cannot be used is said with its column, marker, frame or clock."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from diagnosis_cases import MACHINE_TOML, changed, folder, recording

from diagnosis.reading.read import Read, examine_recording, read_for_diagnosis, stages_present
from recording.content import Recording
from recording.rows import NAN, MarkerCorners, OdometryRow, PlcState, Row, StaticPoint, TrackerPoint
from recording.run import RunInfo

POINTS = MACHINE_TOML + "\n[points]\np = { joint = 6 }\n"
POSES = [StaticPoint(k, (0.1 * k - 0.4,) * 6, "p", 2.0 + 0.1 * k, 0.3 * k, 1.0) for k in range(9)]


def alone(rows: Sequence[Row], toml: str = POINTS) -> Read:
    return examine_recording(Recording("folder", RunInfo("x"), toml, tuple(rows)), Path("x"))


def texts(result: Read, code: str) -> str:
    return " / ".join(str(one) for one in result.findings if one.code == code)


def test_poses_at_rest_with_all_their_columns_are_a_structure() -> None:
    assert stages_present(alone(POSES)) == ("structure",)


@pytest.mark.parametrize(
    ("spoilt", "column"),
    [
        ([replace(one, z_m=NAN) for one in POSES], "z_m: missing"),
        ([replace(one, x_m=NAN, y_m=NAN) for one in POSES], "x_m, y_m: missing"),
        ([replace(one, q_rad=()) for one in POSES], "q_<j>_rad: missing"),
        ([replace(one, q_rad=(*one.q_rad[:2], NAN, *one.q_rad[3:])) for one in POSES], "q_3_rad: missing"),
        ([replace(one, point="") for one in POSES], "point: missing"),
    ],
)
def test_a_column_without_which_no_point_counts_is_named(spoilt: list[Row], column: str) -> None:
    result = alone(spoilt)
    assert f"static.csv: {column}, or empty in every row" in texts(result, "missing_column")
    assert not result.has_judgeable_stage
    assert "static.csv: 0 of 9 rows can be used, least 6" in texts(result, "no_data")


def test_a_column_that_a_folder_lacks_is_named(tmp_path: Path) -> None:
    path = folder(tmp_path, Recording("folder", RunInfo("x"), POINTS, tuple(POSES)))
    lines = (path / "static.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0].endswith(",z_m")
    (path / "static.csv").write_text("\n".join(line.rsplit(",", 1)[0] for line in lines), encoding="utf-8")
    result = read_for_diagnosis(path)
    assert "static.csv: z_m: missing" in texts(result, "missing_column")
    assert not result.has_judgeable_stage


def test_points_that_the_machine_file_does_not_know_are_no_structure() -> None:
    result = alone([replace(one, point="q") for one in POSES])
    assert not result.has_judgeable_stage
    assert "a row needs a point of [points]" in texts(result, "no_data")


def test_tracked_points_need_a_log_of_the_encoders() -> None:
    result = alone([TrackerPoint(0.1 * k, "p", 2.0, 0.1 * k, 1.0) for k in range(20)])
    assert not result.has_judgeable_stage
    assert "tracker.csv: 0 of 20 rows can be used" in texts(result, "no_data")


def looked(marker_id: int, **fields: float) -> list[Row]:
    """A marker on the tool, seen a hundred times."""
    rows = [MarkerCorners(0.1 * k, "left", marker_id, 0, 0, 9, 0, 9, 9, 0, 9) for k in range(100)]
    return [replace(one, **fields) for one in rows]


def on_tool() -> int:
    line = MACHINE_TOML.split('on = "tool"')[0].rsplit("id = ", 1)[1]
    return int(line.split()[0])


def test_markers_count_where_they_are_known() -> None:
    assert stages_present(alone(looked(on_tool()))) == ("camera",)
    strange = alone(looked(977))
    assert not strange.has_judgeable_stage
    assert "markers.csv: 0 of 100 rows can be used" in texts(strange, "no_data")
    unseen = alone(looked(-1))
    assert "markers.csv: marker_id: missing" in texts(unseen, "missing_column")


def test_a_corner_that_was_not_written_is_named() -> None:
    result = alone(looked(on_tool(), v3_px=NAN))
    assert "markers.csv: v3_px: missing, or empty in every row; no marker can be used whole" in texts(
        result, "missing_column"
    )


def test_a_camera_without_its_place_is_no_camera() -> None:
    head, tail = MACHINE_TOML.split("T_tcp_cam_left = [", 1)
    result = alone(looked(on_tool()), head + tail.split("]", 1)[1])
    assert not result.has_judgeable_stage
    assert "camera: [camera] has no T_tcp_cam_left" in texts(result, "no_data")


def test_odometry_without_a_path_is_none() -> None:
    rows = [OdometryRow(0.1 * k, NAN, 0.0, 0.0, NAN, 0.0, 0.0, 0.0) for k in range(50)]
    found = [one for one in alone(rows).findings if one.code == "missing_column"]
    assert [(one.severity, one.text.split(":")[0]) for one in found] == [("problem", "x_m"), ("note", "qw")]


def test_segments_on_another_clock_are_said() -> None:
    made = recording(("steps",))
    later = changed(made, PlcState, lambda _, row: replace(row, t_plc_s=row.t_plc_s + 1.7e9))
    result = examine_recording(later, Path("x"))
    assert not result.has_judgeable_stage
    assert "segments lie at 0 .. " in texts(result, "no_data")
    assert "the log at 1700000000 .. " in texts(result, "no_data")
