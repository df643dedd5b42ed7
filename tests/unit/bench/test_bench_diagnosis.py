"""What is diagnosed for the bench of time and memory, what it tells of one diagnosis, and that it goes on."""

import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.diagnosis.cost import command
from benchmarks.diagnosis.cost.everywhere import Way, written
from benchmarks.diagnosis.cost.made import Size, write_short
from benchmarks.diagnosis.cost.timed import Timed, timed
from benchmarks.diagnosis.links.recorded import FIVE, Course
from diagnosis.reading.read import read_for_diagnosis
from longreach.cli import app


def test_an_arm_of_fewer_joints_has_the_first_ones() -> None:
    whole, two = (tomllib.loads(one.machine_toml(0.005)) for one in (FIVE, Course(joints=2)))
    assert len(whole["joint"]) == 6
    assert set(two) == {"machine", "joint", "plc"}
    assert two["joint"] == whole["joint"][:2]
    assert two["plc"] == whole["plc"]
    assert two["plc"]["log_cycle_s"] == 0.005


def test_the_faults_are_on_the_last_joints() -> None:
    assert [(one.name, one.joint) for one in Size(6).effects] == [("valve_deadband", 6), ("flow_gain_error", 5)]
    assert {one.joint for one in Size(1).effects} == {1}


@pytest.mark.slow
def test_a_diagnosis_is_timed_and_compared_with_what_is_wrong(tmp_path: Path) -> None:
    write_short(tmp_path / "both", 2)
    one = timed(Size(1), tmp_path / "both")
    assert one.exact
    assert one.cpu_s > 0.0
    assert 50.0 < one.peak_mb < 4000.0
    write_short(tmp_path / "healthy", 3)
    assert read_for_diagnosis(tmp_path / "healthy").has_judgeable_stage
    (tmp_path / "healthy" / "plc.csv").unlink()
    with pytest.raises(RuntimeError, match=r"healthy ended with 2: .*no stage can be judged"):
        timed(Size(1), tmp_path / "healthy")


def test_a_fleet_is_written_once(tmp_path: Path) -> None:
    written(tmp_path, 2, 5)
    before = (tmp_path / "00005" / "plc.csv").stat().st_mtime_ns
    written(tmp_path, 3, 5)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["00005", "00006", "00007"]
    assert (tmp_path / "00005" / "plc.csv").stat().st_mtime_ns == before


def test_the_command_tells_the_slowest_and_what_differs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Path] = []

    def made_up(size: Size, recording: Path) -> Timed:
        asked.append(recording)
        return Timed(10.0 * len(asked), 5.0, 300.0, joints=size.joints, exact=len(asked) != 2)

    monkeypatch.setattr(command, "timed", made_up)
    monkeypatch.setattr(command, "everywhere", lambda _recordings, _out: iter([Way("two processes", 1, 7.0, 1)]))
    monkeypatch.setattr(Size, "write", lambda *_: None)
    for n in ("1", "2"):
        words = ["bench", "diagnosis", "--n", n, "--fleet", "1", "--folder", str(tmp_path)]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
    assert [one.name for one in asked] == ["joints-6-1", "joints-1-1", "joints-6-2", "joints-1-2"]
    rows = [line.split("│")[1:-1] for line in done.output.splitlines() if line.startswith("│")]
    cells = [[cell.strip() for cell in row] for row in rows]
    assert ["6", "2", "30.0 s", "5.0 s", "300 MB", "2 of 2"] in cells
    assert ["1", "2", "40.0 s", "5.0 s", "300 MB", "1 of 2"] in cells
    assert ["two processes", "1", "7 s", "1"] in cells
