"""Files that nobody would record: impossible numbers, pipes for files, repeats that are one, exchanged eyes."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML, OFFSET_S, changed, folder, recording

from diagnosis.errors import DiagnosisError
from diagnosis.experiments.postures import candidate_postures
from diagnosis.log.nominal import nominal_of
from diagnosis.reading.read import Read, examine_recording, read_for_diagnosis
from diagnosis.reading.together import read_together
from diagnosis.replay.stretches import repeat_groups
from recording.convert import write_mcap
from recording.rows import MarkerCorners, PlcState, Sent

MADE = recording(("repeat", "repeat"))
HUGE = "1" + 400 * "0"


def fatal_of(result: Read) -> str:
    (found,) = [one for one in result.findings if one.severity == "fatal"]
    assert len(str(found)) < 300
    return str(found)


@pytest.mark.parametrize(
    ("given", "spoilt", "told"),
    [
        ("valve_damping = 0.7", f"valve_damping = {HUGE}", "joint 1: valve_damping = 1000"),
        ("valve_damping = 0.7", "valve_damping = 1e6", "joint 1: valve_damping = 1e+06, limits 0.01 to 10"),
        ("valve_frequency_hz = 40.0", "valve_frequency_hz = 1e9", "limits 0.01 to 1000 Hz"),
        ("velocity_gain_rad_s = 0.50", "velocity_gain_rad_s = 1e-300", "velocity_gain_rad_s = 1e-300, limits"),
        ("kp_frac_per_rad = 2.5", "kp_frac_per_rad = -2.5", "kp_frac_per_rad = -2.5, limits 0 to"),
        ("a_m = 0.16", "a_m = 1950.0", "a_m = 1950, limits -100 to 100 m"),
        ("com_m = [-0.16,", f"com_m = [{HUGE},", "com_m[0]"),
        ("com_m = [-0.16,", "com_m = [true,", "com_m[0] = True is not a finite number"),
        ("q_min_deg = -170.0", "q_min_deg = 171.0", "joint 1: q_min_deg = 171 is not below q_max_deg = 170"),
        ("[machine]", f"deep = {'[' * 100_000}\n[machine]", "is not TOML"),
    ],
)
def test_a_number_that_no_machine_has_is_told_with_its_limits(given: str, spoilt: str, told: str) -> None:
    text = MACHINE_TOML.replace(given, spoilt, 1)
    assert text != MACHINE_TOML
    found = fatal_of(examine_recording(replace(MADE, machine_toml=text), Path("made")))
    assert found.startswith("machine.toml: ")
    assert told in found


@pytest.mark.parametrize("delay", [-1.0, -0.004, 1e12])
def test_a_delay_that_looks_into_the_future_is_refused(delay: float) -> None:
    """The compiled kernel would have read before its arrays' begin."""
    plc = MACHINE_TOML.split("[plc]")[1].split("[", 1)[0]
    lines = [line for line in plc.splitlines() if not line.startswith("transport_delay_s")]
    text = MACHINE_TOML.replace(plc, "\n".join([*lines, f"transport_delay_s = {delay}", ""]))
    with pytest.raises(DiagnosisError, match="transport_delay_s"):
        nominal_of(text)


def test_a_matrix_written_column_by_column_is_no_pose() -> None:
    tool = "[tool]\nT_tcp_tool = [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  0.2, 0.1, 0, 1]\n"
    with pytest.raises(DiagnosisError, match="row by row"):
        nominal_of(f"{tool}\n[machine]\nname = 'x'\n")


def test_a_joint_without_a_gain_has_no_controller() -> None:
    nominal = nominal_of(MACHINE_TOML.replace("kp_frac_per_rad = 2.5", "kp_frac_per_rad = 0.0"))
    assert not nominal.has_controller
    assert nominal.why_absent("controller") == "joint 1 has kp_frac_per_rad = 0: nothing controls it"


@pytest.mark.parametrize("name", ["plc.csv", "run.toml", "machine.toml"])
def test_a_folder_a_pipe_and_a_broken_link_are_no_files(tmp_path: Path, name: str) -> None:
    path = folder(tmp_path, MADE)
    (path / name).unlink()
    for make in (Path.mkdir, os.mkfifo, lambda place: place.symlink_to("nowhere")):
        make(path / name)
        assert f"{name} is a folder, a pipe or a broken link" in fatal_of(read_for_diagnosis(path))
        (path / name).rmdir() if (path / name).is_dir() else (path / name).unlink()


def test_what_lies_beside_the_recording_and_is_no_file_is_passed_over(tmp_path: Path) -> None:
    path = folder(tmp_path, MADE)
    os.mkfifo(path / "pipe.json")
    (path / "loop.urdf").symlink_to("loop.urdf")
    (path / "folder.json").mkdir()
    assert read_for_diagnosis(path).findings == read_for_diagnosis(folder(tmp_path / "plain", MADE)).findings


def test_no_file_at_all_is_told(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    assert "neither a file nor a folder" in fatal_of(read_for_diagnosis(tmp_path / "pipe.mcap"))
    assert "File name too long" in fatal_of(read_for_diagnosis(Path("x" * 5000)))


def test_a_file_too_large_is_not_read(tmp_path: Path) -> None:
    path = folder(tmp_path, MADE)
    os.truncate(path / "plc.csv", 50 * 2**30)  # sparse: it takes no room
    assert "has 50 GB, limit 2 GB; cut it" in fatal_of(read_for_diagnosis(path))


def test_a_quote_that_is_never_closed_is_no_csv(tmp_path: Path) -> None:
    path = folder(tmp_path, MADE)
    content = (path / "plc.csv").read_text()
    (path / "plc.csv").write_text('"' + content + "9" * 200_000)
    assert "a quote that is never closed" in fatal_of(read_for_diagnosis(path))


def test_a_byte_order_mark_is_no_content(tmp_path: Path) -> None:
    path = folder(tmp_path, MADE)
    for name in ("run.toml", "machine.toml"):
        (path / name).write_text("\ufeff" + (path / name).read_text())
    assert read_for_diagnosis(path).findings == read_for_diagnosis(folder(tmp_path / "plain", MADE)).findings


@pytest.mark.parametrize("field", ["plc_to_pc_offset_s = ", "t_start_plc_s = "])
def test_a_time_beyond_all_numbers_is_told(tmp_path: Path, field: str) -> None:
    path = folder(tmp_path, MADE)
    head, tail = (path / "run.toml").read_text().split(field, 1)
    (path / "run.toml").write_text(f"{head}{field}{HUGE}\n{tail.split(chr(10), 1)[1]}")
    assert field.strip(" =") in fatal_of(read_for_diagnosis(path))


def test_an_offset_by_which_two_logs_never_meet_is_told() -> None:
    made = replace(MADE, run_info=replace(MADE.run_info, plc_to_pc_offset_s=1.7e9))
    codes = {(found.code, found.severity) for found in examine_recording(made, Path("made")).findings}
    assert ("clock_offset_wrong", "problem") in codes


def test_one_stretch_under_two_names_is_no_repeat() -> None:
    first, second = MADE.run_info.segments
    later = replace(second, t_start_plc_s=first.t_start_plc_s + 0.02, t_end_plc_s=first.t_end_plc_s + 0.02)
    made = replace(MADE, run_info=replace(MADE.run_info, segments=(first, later)))
    assert "that is not a second measurement" in fatal_of(examine_recording(made, Path("made")))


def test_segments_of_one_name_are_as_many_segments() -> None:
    """Told apart by their names alone, four repeats had been one, and their noise none."""
    one_name = replace(
        MADE, run_info=replace(MADE.run_info, segments=tuple(replace(s, name="A") for s in MADE.run_info.segments))
    )
    result = examine_recording(one_name, Path("made"))
    assert [one.name for one in result.stretches] == ["A", "A (2)"]
    groups = repeat_groups(result.stretches)
    assert [len(members) for members in groups.values()] == [2]


def test_exchanged_eyes_are_told() -> None:
    def seen(t: float, eye: str, u: float) -> MarkerCorners:
        return MarkerCorners(t, eye, 1, u, 100.0, u + 50.0, 100.0, u + 50.0, 150.0, u, 150.0)

    def both(left: float, right: float) -> Read:
        rows = [seen(0.1 * k, *one) for k in range(20) for one in (("left", left), ("right", right))]
        return examine_recording(replace(MADE, rows=(*MADE.rows, *rows)), Path("made"))

    assert "exchange 'left' and 'right'" in fatal_of(both(300.0, 340.0))
    assert "eyes_exchanged" not in {one.code for one in both(340.0, 300.0).findings}


def test_a_recording_given_twice_is_refused(tmp_path: Path) -> None:
    path = folder(tmp_path, MADE)
    with pytest.raises(DiagnosisError, match="run is given twice"):
        read_together([path, tmp_path / "." / "run"])


@pytest.mark.parametrize("content", [None, ""])
def test_a_machine_file_that_is_none_is_named(tmp_path: Path, content: str | None) -> None:
    given = tmp_path / "mine.toml"
    os.mkfifo(given) if content is None else given.write_text(content)
    assert fatal_of(read_for_diagnosis(folder(tmp_path, MADE), given)).startswith("mine.toml: is empty or no file")


def test_postures_stay_inside_a_range_that_was_left() -> None:
    """Limits in radians for degrees: the machine was recorded far outside them."""
    text = MACHINE_TOML.replace("q_min_deg = -25.0", "q_min_deg = -0.44").replace("q_max_deg = 80.0", "q_max_deg = 1.4")
    nominal = nominal_of(text)
    inside = candidate_postures(nominal, np.full(6, 0.5), np.random.default_rng(1))
    assert (inside >= nominal.q_min - 1e-9).all()
    assert (inside[:, 1] <= nominal.q_max[1]).all()


def test_half_a_converted_file_holds_half_of_every_kind(tmp_path: Path) -> None:
    """Kinds take turns as while recording; one after the other, the cut would have left the first one only."""
    whole = tmp_path / "whole.mcap"
    write_mcap(MADE, whole)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    tables = read_for_diagnosis(cut).tables
    assert tables is not None
    assert tables.plc is not None
    assert tables.sent is not None
    assert tables.plc.t_s[-1] == pytest.approx(tables.sent.t_s[-1] - OFFSET_S, abs=2.0)
    assert len(tables.plc.t_s) > 1000


def test_a_clock_that_jumps_back_keeps_its_place_when_converted(tmp_path: Path) -> None:
    def back(k: int, row: PlcState) -> PlcState:
        return replace(row, t_plc_s=row.t_plc_s - 5.0) if k > 1200 else row

    made = changed(MADE, PlcState, back)
    write_mcap(made, tmp_path / "back.mcap")
    again = read_for_diagnosis(tmp_path / "back.mcap").tables
    assert again is not None
    assert again.plc is not None
    assert again.plc.t_s.tolist() == [row.t_plc_s for row in made.of(PlcState)]


def test_what_a_damaged_file_still_held_is_said(tmp_path: Path) -> None:
    lean = replace(MADE, rows=tuple(MADE.of(Sent)))
    write_mcap(lean, tmp_path / "lean.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((tmp_path / "lean.mcap").read_bytes()[:-40_000])
    (finding,) = [found for found in read_for_diagnosis(cut).findings if found.code == "no_data"]
    assert "of the damaged file: " in finding.text
    assert " of sent" in finding.text
    assert "camera:" not in finding.text


def test_rows_from_the_last_to_the_first_are_told_and_no_sign_is_blamed() -> None:
    backwards = replace(MADE, rows=tuple(sorted(MADE.of(PlcState), key=lambda row: -row.t_plc_s)))
    assert fatal_of(examine_recording(backwards, Path("backwards"))).startswith("plc.csv: time runs backwards from ")


def test_text_of_two_bytes_a_letter_is_told(tmp_path: Path) -> None:
    path = folder(tmp_path, MADE)
    text = (path / "plc.csv").read_text(encoding="utf-8")
    (path / "plc.csv").write_bytes(text.encode("utf-16-be"))
    assert "save it as UTF-8" in fatal_of(read_for_diagnosis(path))


def test_channels_of_others_are_a_note() -> None:
    message = "/odometry (json, schema 'nav_msgs/Odometry'): 7 messages were not read"
    findings = examine_recording(replace(MADE, foreign_channels=(message,)), Path("made")).findings
    assert [finding.severity for finding in findings if message in str(finding)] == ["note"]


def test_a_column_that_is_there_twice_is_read_as_neither(tmp_path: Path) -> None:
    """A header pasted over the valve's column: its commands had been read as the encoder."""
    path = folder(tmp_path, MADE)
    text = (path / "plc.csv").read_text(encoding="utf-8")
    (path / "plc.csv").write_text(text.replace("u_1_frac", "q_1_rad", 1), encoding="utf-8")
    told = [str(found) for found in read_for_diagnosis(path).findings if found.severity == "fatal"]
    assert any("column 'q_1_rad' is there twice (columns " in one for one in told)


def test_a_column_of_somebodys_own_may_be_there_twice(tmp_path: Path) -> None:
    path = folder(tmp_path, MADE)
    text = (path / "plc.csv").read_text(encoding="utf-8")
    (path / "plc.csv").write_text(
        text.replace("t_oil_c", "mine", 1).replace("p_supply_pa", "mine", 1), encoding="utf-8"
    )
    result = read_for_diagnosis(path)
    assert "column 'mine' is there twice; remove one" in [
        one.text for one in result.findings if one.severity == "problem"
    ]
    assert result.has_judgeable_stage
