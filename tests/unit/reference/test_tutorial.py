"""The commands of the tutorials as written there: run here, or with a machine by the test that is named."""

import shlex
import shutil
from importlib.resources import files
from pathlib import Path

import pytest
from test_documents import BLOCK, DOCS
from typer.testing import CliRunner

from longreach.cli import app

TESTS = DOCS.parent / "tests"
NEEDS_A_MACHINE = {  # command: the test that runs it with a simulated machine, camera, server or recording
    "demo": "system/test_interrupted_first_start.py",
    "camera check": "system/test_camera_check_command.py",
    "target teach": "unit/vision/test_target_command.py",
    "commission": "system/test_commission.py",
    "serve": "system/test_killed_server.py",
    "position": "system/test_positioning.py",
    "recording check": "unit/recording/test_recording_commands.py",
    "recording rerun": "unit/recording/test_recording_viewers.py",
    "diagnose": "unit/diagnosis/whole/test_diagnosis_answer.py",
    "identify": "system/test_panel_identify.py",
    "sim": "system/test_sim_process.py",
    "compare": "unit/diagnosis/whole/test_diagnosis_compare.py",
}


def commands_of(page: str) -> list[list[str]]:
    text = (DOCS / page).read_text(encoding="utf-8")
    lines = [line for kind, block in BLOCK.findall(text) if kind == "sh" for line in block.splitlines()]
    lines += [line.strip() for line in text.splitlines() if line.startswith("    longreach ")]
    ours = [line.split("[")[0] for line in lines if Path(line.split(" ")[0]).name == "longreach"]
    return [shlex.split(line, comments=True)[1:] for line in ours]


@pytest.mark.parametrize("page", ["tutorial.md", "identify.md"])
def test_every_command_is_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with (files("machine") / "machines" / "hiab033.toml").open("rb") as shipped, open("crane-7.toml", "wb") as own:
        shutil.copyfileobj(shipped, own)
    commands = commands_of(page)
    assert len(commands) >= 3
    for words in commands:
        name = next((name for name in NEEDS_A_MACHINE if " ".join(words).startswith(name)), None)
        if name is not None:
            assert (TESTS / NEEDS_A_MACHINE[name]).is_file()
            continue
        before = set(Path().rglob("*"))
        done = CliRunner().invoke(app, words[: words.index(">")] if ">" in words else words)
        assert done.exit_code == 0, (words, done.output)
        assert set(Path().rglob("*")) > before or "keys" in words
