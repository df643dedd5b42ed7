"""The list of commands is right without any of them being imported."""

import importlib
import json
import os
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from benchmarks.cli import BENCHES
from longreach.cli import CLI_COMMANDS, app
from longreach.lazy_commands import Lazy

HEAVY = {
    "cv2",
    "numba",
    "scipy",
    "fastapi",
    "numpy",
    "uvicorn",
    "httpx",
    "asyncua",
    "matplotlib",
}  # pydantic is typer's
LOADED = """
import json, sys
from typer.testing import CliRunner
from longreach.cli import app
answer = CliRunner().invoke(app, json.loads(sys.argv[1]))
assert answer.exit_code == 0, answer.output
print(json.dumps([answer.output, sorted(name for name in sys.modules if "." not in name)]))
"""


@pytest.mark.parametrize(
    ("arguments", "told"),
    [(["--help"], "diagnose-fleet"), (["serve", "--help"], "--first-key"), (["bench", "--help"], "vision-real")],
)
def test_help_imports_nothing_heavy(arguments, told):
    command = [sys.executable, "-c", LOADED, json.dumps(arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env={**os.environ, "COLUMNS": "200"})
    output, modules = json.loads(done.stdout)
    assert told in output
    assert HEAVY & set(modules) == set()
    assert "typer" in modules  # the list is that of this process


@pytest.mark.parametrize("one", CLI_COMMANDS + BENCHES, ids=lambda one: one.import_path)
def test_each_is_there_and_the_list_says_what_it_says_of_itself(one):
    command = one.load()
    assert command.name == one.name
    module, _, attribute = one.import_path.partition(":")
    if isinstance(getattr(importlib.import_module(module), attribute), typer.Typer):
        assert command.commands
    assert " ".join(command.help.split()) == one.help_text


def test_a_command_of_the_table_takes_its_own_arguments_and_a_typo_is_answered():
    shown = CliRunner().invoke(app, ["recording", "check", "--help"])
    assert (shown.exit_code, "recording check" in shown.output) == (0, True)
    wrong = CliRunner().invoke(app, ["diagnos"])
    assert wrong.exit_code == 2
    assert "diagnose" in wrong.output


def test_a_function_and_a_group_become_commands(monkeypatch):
    module = type(sys)("made_here")
    module.app, module.told = typer.Typer(), []

    @module.app.command()
    def first(times: int) -> None:
        module.told.append(times)

    @module.app.command()
    def second() -> None:
        """Unused: a group has more than one."""

    def alone(name: str = "x") -> None:
        """Say it."""
        module.told.append(name)

    module.alone = alone
    monkeypatch.setitem(sys.modules, "made_here", module)
    Lazy("group", "made_here:app", "A group.").load().main(["first", "3"], standalone_mode=False)
    Lazy("alone", "made_here:alone", "Say it.").load().main(["--name", "y"], standalone_mode=False)
    assert module.told == [3, "y"]
