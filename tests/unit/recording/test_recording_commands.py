"""`longreach recording check` and `recover` as a person reads them."""

from pathlib import Path

from typer.testing import CliRunner

from longreach.cli import app
from recording.run import RunInfo
from recording.writer import RunWriter


def said(arguments: list[str], code: int = 0) -> str:
    done = CliRunner().invoke(app, ["recording", *arguments], env={"COLUMNS": "200"})
    assert done.exit_code == code, done.output
    return done.output


def test_a_check_is_a_table_with_units_and_says_what_is_missing_and_the_remedy(tmp_path: Path) -> None:
    rows = "".join(f"{0.01 * k:.2f},0.{k % 10}\n" for k in range(200))
    (tmp_path / "plc.csv").write_text(f"t_plc_s,q_1_rad\n{rows}", encoding="utf-8")
    told = said(["check", str(tmp_path)])
    assert "rate [Hz]" in told
    assert any(line.split()[1:4] == ["plc", "│", "200"] for line in told.splitlines()), told
    assert "without sent.csv: the link stage cannot be examined" in told
    assert "CheckReport(" not in told


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["recording", "check", str(tmp_path)])
    assert done.exit_code == 2


def test_a_target_that_was_not_saved_is_not_in_the_next_ones_way(tmp_path: Path) -> None:
    target = tmp_path / "out.mcap"
    assert "No such file" in said(["recover", str(tmp_path / "nope.mcap"), str(target)], 2)
    assert not target.exists()
    source = tmp_path / "run.mcap"
    RunWriter(source, RunInfo("x")).close()
    nowhere = tmp_path / "none" / "out.mcap"
    told = said(["recover", str(source), str(nowhere)], 2)
    assert "cannot be written: No such file or directory; choose a folder that can be written" in told
    assert "nothing was damaged" in said(["recover", str(source), str(target)])
    before = target.read_bytes()
    assert "exists already" in said(["recover", str(source), str(target)], 2)
    assert target.read_bytes() == before


def test_units_and_odd_paths_are_told_as_they_are(tmp_path: Path) -> None:
    segment = '[[segment]]\nkind = "hold"\nt_start_plc_s = 1\nt_end_plc_s = "3"\n'
    (tmp_path / "run.toml").write_text(segment, encoding="utf-8")
    assert "t_end_plc_s = '3' is not a number between -1e+20 and 1e+20 [s]" in said(["check", str(tmp_path)], 2)
    odd = tmp_path / "[" / "b]"
    assert "[/b]" in said(["check", str(odd)], 2)
    source = tmp_path / "run[/b].mcap"
    RunWriter(source, RunInfo("x")).close()
    assert "[/b]_folder" in said(["convert", str(source), str(tmp_path / "run[/b]_folder")])
    assert "[/b].again" in said(["recover", str(source), str(tmp_path / "run[/b].again")])
