"""`longreach export-plc`: what it writes, what it refuses, what it tells."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from longreach.cli import app
from longreach.export_command import st_sources

RUNNER = CliRunner(env={"COLUMNS": "400", "TERM": "dumb", "NO_COLOR": "1"})


def written(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_two_exports_are_identical_and_begin_with_the_start_page(tmp_path):
    options = ["--pc-net-id", "5.1.2.3.1.1", "--plc-net-id", "5.1.2.4.1.1", "--plc-address", "10.0.0.4"]
    for name in ("a", "b"):
        done = RUNNER.invoke(app, ["export-plc", str(tmp_path / name), *options])
        assert done.exit_code == 0, done.output
        assert f"begin with {tmp_path / name / 'README.md'}" in done.output
    first = written(tmp_path / "a")
    assert first == written(tmp_path / "b")
    assert len(first) > 50
    assert b"| PLC | 10.0.0.4, AMS NetId 5.1.2.4.1.1 |" in first["README.md"]
    assert b"| PC | 5.1.2.3, AMS NetId 5.1.2.3.1.1 |" in first["README.md"]


def test_another_process_with_another_hash_seed_writes_the_same(tmp_path):
    done = RUNNER.invoke(app, ["export-plc", str(tmp_path / "here")])
    assert done.exit_code == 0
    there = [sys.executable, "-m", "longreach.cli", "export-plc", str(tmp_path / "there")]
    subprocess.run(there, check=True, capture_output=True, env={"PYTHONHASHSEED": "7"}, timeout=120)
    assert written(tmp_path / "here") == written(tmp_path / "there")


def test_a_folder_that_is_not_empty_needs_force_and_older_files_are_told(tmp_path):
    (tmp_path / "FB_Old.TcPOU").write_text("old")
    refused = RUNNER.invoke(app, ["export-plc", str(tmp_path)])
    assert refused.exit_code == 2
    assert "is not empty" in refused.output
    assert written(tmp_path) == {"FB_Old.TcPOU": b"old"}
    forced = RUNNER.invoke(app, ["export-plc", str(tmp_path), "--force"])
    assert forced.exit_code == 0
    assert "1 older files are still there; do not import them: FB_Old.TcPOU" in forced.output
    assert (tmp_path / "MANIFEST.txt").is_file()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--pc-net-id", "1.2.3"], "--pc-net-id: AMS NetId '1.2.3'"),
        (["--plc-net-id", "1.2.3.4.5.256"], "--plc-net-id: AMS NetId"),
        (["--pc-address", "1.2.3"], "--pc-address"),
        (["--plc-address", "10.0.0.256"], "--plc-address"),
    ],
)
def test_bad_options_are_refused_before_anything_is_written(tmp_path, options, told):
    done = RUNNER.invoke(app, ["export-plc", str(tmp_path / "out"), *options])
    assert done.exit_code == 2
    assert told in done.output
    assert not (tmp_path / "out").exists()


def test_a_file_in_the_way_is_told(tmp_path):
    (tmp_path / "out").write_text("")
    done = RUNNER.invoke(app, ["export-plc", str(tmp_path / "out"), "--force"])
    assert done.exit_code == 2
    assert "is a file: give a folder" in done.output


def test_the_sources_are_package_data():
    sources = st_sources()
    assert {"MAIN.st", "FB_HmPlc.st", "FB_HmLink.st", "F_HmCrc32.st"} <= set(sources)
