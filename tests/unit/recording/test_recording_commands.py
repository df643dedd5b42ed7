"""`longreach recording check` and `recover` as a person reads them."""

from pathlib import Path

from typer.testing import CliRunner

from longreach.cli import app


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
    assert "without sent.csv: stage link cannot be looked at" in told
    assert "CheckReport(" not in told


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["recording", "check", str(tmp_path)])
    assert done.exit_code == 2
