"""Several recordings as one: each is looked at as if it came alone, and none changes what another one says."""

from dataclasses import replace
from pathlib import Path

import pytest
from diagnosis_cases import MACHINE_TOML, changed, recording

from diagnosis.errors import DiagnosisError
from diagnosis.reading.together import join_recordings, read_together
from recording.content import Recording
from recording.convert import write_mcap
from recording.folder import write_folder
from recording.rows import PlcState, Sent, StaticPoint
from recording.run import RunInfo

MADE = recording(("repeat", "repeat"))


def folders(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / "a", tmp_path / "b"]
    for path in paths:
        write_folder(MADE, path)
    return paths


def renamed(path: Path, old: str, new: str) -> None:
    text = (path / "plc.csv").read_text(encoding="utf-8")
    assert old in text
    (path / "plc.csv").write_text(text.replace(old, new, 1), encoding="utf-8")


@pytest.mark.parametrize("which", [0, 1])
def test_columns_of_each_folder_are_looked_at(tmp_path: Path, which: int) -> None:
    paths = folders(tmp_path)
    renamed(paths[which], "u_6_frac", "u_6_fracc")
    told = [str(one) for one in read_together(paths).findings]
    name = paths[which].name
    assert f"plc.csv: of {name}: column 'u_6_fracc' was not read; did you mean 'u_6_frac'?" in told


def test_metres_of_a_joint_that_turns_are_told_of_each_folder(tmp_path: Path) -> None:
    paths = folders(tmp_path)
    renamed(paths[1], ",q_1_rad,", ",q_1_m,")
    for path in paths:
        (path / "run.toml").unlink()
    whole = read_together(paths)
    assert not whole.has_judgeable_stage
    told = " ".join(str(one) for one in whole.findings)
    assert "plc.csv: of b: column 'q_1_m' is in m, but joint 1 of the machine file turns" in told
    assert "run.toml: of b: is not there" in told


def test_files_of_channels_are_called_by_their_channels(tmp_path: Path) -> None:
    gap = changed(MADE, PlcState, lambda k, row: replace(row, t_plc_s=row.t_plc_s + (5.0 if k > 1200 else 0.0)))
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path in paths:
        write_mcap(gap, path)
    findings = read_together(paths).findings
    assert findings
    assert not any("plc.csv" in str(one) for one in findings)


def row_of(seq: int, t_s: float) -> PlcState:
    return PlcState(t_s, seq, (), (), (0.1,), (), (), (), 2e7, 40.0)


def test_rows_without_a_number_stay_without_one() -> None:
    sent, nothing = (Sent(0.0, 5, (0.1,)), Sent(0.1, -1, (0.1,))), 2**64 - 1
    plc, static = (row_of(7, 0.2), row_of(nothing, 0.3)), StaticPoint(-1, (0.1,), "p", 0.0, 0.0, 0.0)
    first = Recording("folder", RunInfo("a"), "", (*sent, *plc, static))
    both = join_recordings([first, first])
    assert [row.seq for row in both.of(Sent)] == [5, -1, 13, -1]
    assert [row.seq_received for row in both.of(PlcState)][2:] == [15, nothing]
    assert [row.pose_index for row in both.of(StaticPoint)] == [-1, -1]


def test_other_numbers_of_joints_do_not_go_together() -> None:
    one = Recording("folder", RunInfo("a"), MACHINE_TOML, (row_of(1, 0.0),))
    two = replace(one, rows=(replace(row_of(1, 0.0), q_rad=(0.1, 0.2)),))
    empty = replace(one, rows=())
    with pytest.raises(DiagnosisError, match="recording 3 has 2 joints, recording 2 has 1; give recordings of one"):
        join_recordings([empty, one, two])
    assert len(join_recordings([one, empty]).rows) == 1
