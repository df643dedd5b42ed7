"""Every `longreach` command in README.md and docs exists, with the options that are given; the README's Python runs."""

import re
import shlex
from pathlib import Path

import pytest
import typer.main

from longreach.cli import app
from longreach.lazy_commands import loaded

ROOT = Path(__file__).parents[3]
RECORDS = {"evidence-ledger.md"}  # what was measured at its time, by commands of its time
PAGES = sorted(
    path
    for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
    if path.name not in RECORDS and "longreach " in path.read_text(encoding="utf-8")
)
FENCE = re.compile(r"^```\w*\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"(?:^ {4,}|`|/bin/|&& )longreach ((?:[^`\n\\]|\\\n)*)", re.MULTILINE)


def commands(text: str) -> list[str]:
    """The commands of a page, without comments, pipes and brackets around optional parts."""
    code = FENCE.sub(lambda fence: re.sub(r"^", "    ", fence[1], flags=re.MULTILINE), text)
    found = [re.sub(r"\\\n", " ", part) for part in COMMAND.findall(code)]
    plain = [re.split(r"\s#|[|>;]|\s&&", part)[0].replace("[", " ").replace("]", " ") for part in found]
    return [part for part in plain if re.match(r"-|[a-z]", part)]


def fault(command: str) -> str:
    """What does not exist, or nothing."""
    here, words, group = typer.main.get_command(app), shlex.split(command.replace("'", "")), True
    for word in words:
        if group and not word.startswith("-"):
            if word not in here.commands:
                return f"no command {word}"
            here = loaded(here.commands[word])
            group = hasattr(here, "commands")
        elif word.startswith("--") and len(word) > 2:
            known = {name for option in here.params for name in (*option.opts, *option.secondary_opts)} | {"--help"}
            if word.partition("=")[0] not in known:
                return f"no option {word}"
    return ""


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_command_of_the_page_exists(page: Path):
    found = commands(page.read_text(encoding="utf-8"))
    assert {command: fault(command) for command in found if fault(command)} == {}


def test_a_wrong_command_or_option_is_found():
    assert fault("positoin --help") == "no command positoin"
    assert fault("recording check --hmtl FILE") == "no option --hmtl"
    assert [command.split() for command in commands("    longreach sim [--preset ideal] # comment\n")] == [
        ["sim", "--preset", "ideal"]
    ]


def test_the_python_example_of_the_readme_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(ROOT)
    ((code,),) = [re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)]
    exec(compile(code, "README.md", "exec"), {})
    assert "mm" in capsys.readouterr().out
