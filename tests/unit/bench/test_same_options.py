"""A bench prints only cases of its own configuration."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.same_options import FILE, require_same_options, text_mark
from longreach.cli import app
from server.errors import SettingsError

BENCHES = [
    ("servo", "", ("retract_mm", "silence_max_ms", "camera_rate_hz")),
    ("compensation", "", ("machine",)),
    ("camera-faults", "", ("machine",)),
    ("markers", "", ("machine",)),
    ("vision-soak", "", ("machine",)),
    ("jobs-soak", "full", ("preset",)),
    ("fuzz", "", ("machine",)),
]


def refused(bench: str, folder: Path) -> str:
    """What a bench says before any work."""
    done = CliRunner().invoke(app, ["bench", bench, "--folder", str(folder)])
    assert isinstance(done.exception, SettingsError), done.output
    return str(done.exception)


@pytest.mark.parametrize(("bench", "below", "options"), BENCHES)
def test_cases_of_other_options_are_not_told_as_this_runs_own(tmp_path, bench, below, options):
    cases = tmp_path / below
    cases.mkdir(exist_ok=True)
    (cases / FILE).write_text(json.dumps(dict.fromkeys(options, "another")), encoding="utf-8")
    told = refused(bench, tmp_path)
    assert [name for name in options if f"{name} another, asked for" not in told] == []
    assert "give another --folder, or delete this one" in told


@pytest.mark.parametrize(("bench", "below", "options"), BENCHES)
def test_cases_of_options_that_nobody_wrote_down_are_not_told_either(tmp_path, bench, below, options):
    cases = tmp_path / below
    cases.mkdir(exist_ok=True)
    (cases / "1.json").write_text("{}", encoding="utf-8")
    assert f"holds cases but no {FILE}" in refused(bench, tmp_path)


def test_a_run_with_the_same_options_resumes(tmp_path):
    folder = tmp_path / "new"
    require_same_options(folder, retract_mm=60.0, machine=text_mark("a"))
    (folder / "1.json").write_text("{}", encoding="utf-8")
    require_same_options(folder, retract_mm=60.0, machine=text_mark("a"))
    told = "retract_mm 60.0, asked for 40.0; give"
    with pytest.raises(SettingsError, match=told):
        require_same_options(folder, retract_mm=40.0, machine=text_mark("a"))
    with pytest.raises(SettingsError, match="machine SHA-256"):
        require_same_options(folder, retract_mm=60.0, machine=text_mark("b"))
