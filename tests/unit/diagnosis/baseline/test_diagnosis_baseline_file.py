"""A baseline's machine file is made from what the recordings hold, whichever form they have, and asked for first."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnosis_cases import MACHINE_TOML, folder, recording
from rich.console import Console

from diagnosis.baseline.baseline import Baseline
from longreach import fit_baseline
from recording.convert import convert
from recording.folder import write_folder

SCREEN = Console(quiet=True)


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many recordings each fit was given; the fit itself takes minutes and has tests of its own."""
    calls: list[int] = []

    def nothing(fitting: Any, judging: Any, _say: Any) -> Baseline:
        calls.append(len(fitting) + len(judging))
        return Baseline((), (), ())

    monkeypatch.setattr(fit_baseline, "fit_baseline", nothing)
    return calls


@pytest.mark.parametrize("form", ["folder", "mcap"])
def test_the_machine_file_of_the_first_recording_is_taken(form: str, fitted: list[int], tmp_path: Path) -> None:
    run = folder(tmp_path, recording())
    if form == "mcap":
        convert(run, tmp_path / "run.mcap")
        run = tmp_path / "run.mcap"
    fit_baseline.make_baseline([run, run, run], None, tmp_path / "machine.toml", SCREEN)
    assert fitted == [3]
    assert (tmp_path / "machine.toml").read_text(encoding="utf-8").strip() == MACHINE_TOML.strip()


def test_no_machine_file_is_told_before_anything_is_fitted(fitted: list[int], tmp_path: Path) -> None:
    write_folder(replace(recording(), machine_toml=""), tmp_path / "run")
    with pytest.raises(fit_baseline.BaselineError, match="give one by --machine"):
        fit_baseline.make_baseline([tmp_path / "run"] * 3, None, tmp_path / "out.toml", SCREEN)
    assert fitted == []


def test_what_is_no_recording_is_told(fitted: list[int], tmp_path: Path) -> None:
    with pytest.raises(fit_baseline.BaselineError, match="no such"):
        fit_baseline.make_baseline([tmp_path / "no such"] * 3, None, tmp_path / "out.toml", SCREEN)
    assert fitted == []


def test_every_recording_that_cannot_be_used_is_named_at_once(fitted: list[int], tmp_path: Path) -> None:
    sound = folder(tmp_path, recording())
    given = [sound, tmp_path / "first", sound, tmp_path / "second"]
    with pytest.raises(fit_baseline.BaselineError, match=r"leave out or fix: .*/first: .*\n.*/second: "):
        fit_baseline.make_baseline(given, None, tmp_path / "out.toml", SCREEN)
    assert fitted == []


@pytest.mark.parametrize("content", [None, b"[machine]\nname = '\xe4'\n"])
def test_a_machine_file_that_cannot_be_read_is_told(fitted: list[int], tmp_path: Path, content: bytes | None) -> None:
    given = tmp_path / "nope.toml"
    if content is not None:
        given.write_bytes(content)
    run = folder(tmp_path, recording())
    with pytest.raises(fit_baseline.BaselineError, match=r"machine file .*nope\.toml"):
        fit_baseline.make_baseline([run] * 3, given, tmp_path / "out.toml", SCREEN)
    assert fitted == []


def test_a_machine_file_that_cannot_be_taken_apart_is_told_before_anything_is_fitted(
    fitted: list[int], tmp_path: Path
) -> None:
    text = 'notes = """\n[[effect]]\n"""\n' + MACHINE_TOML
    run = folder(tmp_path, replace(recording(), machine_toml=text))
    with pytest.raises(fit_baseline.BaselineError, match=r"\[\[effect\]\]"):
        fit_baseline.make_baseline([run] * 3, None, tmp_path / "out.toml", SCREEN)
    assert fitted == []
    assert not (tmp_path / "out.toml").exists()
