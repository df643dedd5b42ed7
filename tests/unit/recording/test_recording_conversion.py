"""Folders of CSV and MCAP, one into the other."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from written_runs import MACHINE_TOML, plc_state, same, write

from recording.check import check_recording
from recording.content import Recording, column
from recording.convert import convert, write_mcap
from recording.errors import RecordingError
from recording.folder import write_folder
from recording.opening import read_run
from recording.rows import MarkerCorners, OdometryRow, PlcState, Sent
from recording.run import RunInfo


def test_folder_and_back_keeps_every_csv_number(tmp_path: Path) -> None:
    source = write(tmp_path / "run.mcap")
    convert(source, tmp_path / "folder")
    header = (tmp_path / "folder" / "plc.csv").read_text().splitlines()[0].split(",")
    assert header[:4] == ["t_plc_s", "seq_received", "q_ref_1_rad", "q_ref_2_rad"]
    assert header[-3:] == ["p_supply_pa", "t_oil_c", "t_receive_pc_s"]
    assert "u_6_frac" in header
    assert (tmp_path / "folder" / "machine.toml").read_text() == MACHINE_TOML
    convert(tmp_path / "folder", tmp_path / "again.mcap")
    first, again = read_run(source), read_run(tmp_path / "again.mcap")
    assert again.run_info == first.run_info
    for row_type in (PlcState, Sent, MarkerCorners, OdometryRow):
        assert len(again.of(row_type)) == len(first.of(row_type))
    for name in ("t_plc_s", "seq_received", "q_ref_rad", "q_rad", "u_frac", "p_a_pa", "p_supply_pa", "t_oil_c"):
        np.testing.assert_array_equal(column(again.of(PlcState), name), column(first.of(PlcState), name))
    assert same(again.of(MarkerCorners)[3], first.of(MarkerCorners)[3])


def test_converting_over_something_is_refused(tmp_path: Path) -> None:
    source = write(tmp_path / "run.mcap", 3)
    with pytest.raises(RecordingError, match="exists already"):
        convert(source, source)


def test_a_foreign_folder_with_few_columns(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("[run]\nname = 'x'\noperator = 'unknown key'\n")
    (tmp_path / "plc.csv").write_text("q_2_rad,t_plc_s,q_1_rad,extra\n0.2,1.0,0.1,z\n,1.1,,\n\n")
    recording = read_run(tmp_path)
    rows = recording.of(PlcState)
    assert rows[0].q_rad == (0.1, 0.2)
    assert rows[1].q_rad == ()
    assert rows[0].seq_received == -1
    assert math.isnan(rows[0].p_supply_pa)
    report = check_recording(tmp_path)
    lacking = {missing.signal for missing in report.missing_signals}
    assert {"sent.csv", "plc.csv u", "machine.toml"} <= lacking
    assert "plc.csv q" not in lacking
    assert not any("p_a" in one or "p_supply" in one for one in lacking)  # the diagnosis reads no pressure
    assert not report.usable


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("t_plc_s,q_1_rad\n1.0,0\n2.0,0,5\n", "line 3: 3 cells under 2 column names"),
        ("t_plc_s,q_1_rad\n1.0,0,\nx,1\n", "line 3.*'x' is not a number"),
        ("t_plc_s,q_1_rad,q_3_rad\n1.0,0,5\n", r"joints \[1, 3\]"),
        ("time,q_1_rad\n1.0,0\n", "column 't_plc_s' is missing"),
        (
            "t_plc_s,q_1_rad,q_2_rad,q_1_rad\n1.0,0,1,2\n",
            r"plc\.csv: column 'q_1_rad' is there twice \(columns 2 and 4 of the file\)",
        ),
        (
            "t_plc_s,q_1_rad,q_01_rad\n1.0,0,1\n",
            r"column 'q_1_rad' is there twice, as 'q_1_rad' and as 'q_01_rad' \(columns 2 and 3",
        ),
        (
            "t_plc_s,p_supply_pa,q_1_rad,p_supply_pa\n1.0,0,1,2\n",
            r"column 'p_supply_pa' is there twice \(columns 2 and 4",
        ),
        ("t_plc_s,q_1_rad,q_1_m\n1.0,0,1\n", r"'q_1_m' is there in two units \(columns 2 and 3"),
    ],
)
def test_bad_csv_names_the_place(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "run.toml").write_text("[run]\nname = 'x'\n")
    (tmp_path / "plc.csv").write_text(text)
    with pytest.raises(RecordingError, match=match):
        read_run(tmp_path)


def test_an_infinite_count_in_a_folder_is_named(tmp_path: Path) -> None:
    write_folder(read_run(write(tmp_path / "whole.mcap", 3)), tmp_path / "run")
    path = tmp_path / "run" / "sent.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    column = lines[0].split(",").index("seq")
    cells = lines[1].split(",")
    cells[column] = "inf"
    path.write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"sent\.csv.*'inf' is not a count"):
        read_run(tmp_path / "run")


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda row: replace(row, seq_received=2**64 - 1), "seq_received = 18446744073709551615, limits"),
        (lambda row: replace(row, t_plc_s=1e30), r"its time is 1e\+30 s in UTC, limits 0 to"),
    ],
)
def test_a_row_that_mcap_cannot_hold_is_named_and_nothing_is_written(
    tmp_path: Path, spoil: Callable[[PlcState], PlcState], told: str
) -> None:
    rows = [plc_state(number) for number in range(300)]
    rows[9] = spoil(rows[9])
    write_folder(Recording("folder", RunInfo("odd"), "", tuple(rows)), tmp_path / "run")
    with pytest.raises(RecordingError, match=rf"plc\.csv, row 10: {told}"):
        convert(tmp_path / "run", tmp_path / "run.mcap")
    assert not (tmp_path / "run.mcap").exists()


def test_an_offset_before_all_time_is_named(tmp_path: Path) -> None:
    run = RunInfo("odd", pc_to_utc_offset_s=-1000.0)
    with pytest.raises(RecordingError, match=r"plc\.csv, row 1: its time is -900 s in UTC.*fix .* \[clocks\]"):
        write_mcap(Recording("folder", run, "", (plc_state(0),)), tmp_path / "run.mcap")


def test_a_file_that_broke_off_is_no_conversion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_args: object, **_kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("recording.writer.McapWriter.add_message", full)
    with pytest.raises(RecordingError, match="No space left"):
        write_mcap(Recording("folder", RunInfo("full"), "", (plc_state(0),)), tmp_path / "run.mcap")
    assert not (tmp_path / "run.mcap").exists()
