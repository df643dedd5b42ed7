"""What README.md and the pages of docs say to type exists: commands with their options, settings, files, links."""

import re
import shlex
import tomllib
from itertools import pairwise
from pathlib import Path

import pytest
import typer

from longreach.cli import app
from longreach.lazy_commands import loaded_command
from server.settings import ServerSettings

DOCS = Path(__file__).parents[3] / "docs"
PAGES = ("tutorial.md", "scale.md", "rest.md", "security.md", "docker.md")
README = DOCS.parent / "README.md"
RECORDS = {"evidence-ledger.md"}  # what was measured at its time, by commands of its time
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)


def said(page: Path) -> list[str]:
    """Every command line of a page that calls longreach: in blocks, indented, or as code in a sentence."""
    text = page.read_text(encoding="utf-8")
    lines = [line.strip() for _, block in BLOCK.findall(text) for line in block.splitlines()]
    lines += [line.strip() for line in text.splitlines() if line.startswith("    ")]
    lines += re.findall(r"`(longreach [^`]+)`", text)
    found = (re.search(r"(?:^|\s|/)longreach\s+(?=[a-z])(.*)", line.split("  #")[0]) for line in lines)
    return [match.group(1) for match in found if match and not line_of_python(match.string)]


def line_of_python(line: str) -> bool:
    return line.startswith(("import ", "from ", "#"))


WITH_COMMANDS = [page for page in (README, *sorted(DOCS.glob("*.md"))) if page.name not in RECORDS and said(page)]


def unknown(line: str) -> str:
    """What of a command line there is not; empty when all of it is."""
    command = typer.main.get_command(app)
    line = re.sub(r"[][']", " ", re.split(r"[|>;]", line)[0])  # brackets around optional parts
    words = [word for word in shlex.split(line, comments=True) if word != "..."]
    while words and (children := getattr(command, "commands", None)):
        if words[0] not in children:
            return f"no command {words[0]}"
        command = loaded_command(children[words.pop(0)])
    options = {name for one in command.params for name in (*one.opts, *one.secondary_opts)}
    wrong = [word for word in words if word.startswith("--") and word.split("=")[0] not in options | {"--help"}]
    return f"no option {wrong[0]}" if wrong else ""


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.name)
def test_every_command_exists(page):
    lines = said(page)
    assert {line: told for line in lines if (told := unknown(line))} == {}


def test_a_command_that_there_is_not_is_found():
    assert unknown("serve --settings plant.toml") == ""
    assert unknown("serve --settigns plant.toml") == "no option --settigns"
    assert unknown("serf") == "no command serf"
    assert unknown("target paint prints") == "no command paint"


@pytest.mark.parametrize("page", PAGES)
def test_settings_are_taken(page):
    for kind, block in BLOCK.findall((DOCS / page).read_text(encoding="utf-8")):
        if kind == "toml":
            ServerSettings.model_validate(tomllib.loads(block))


@pytest.mark.parametrize("page", [README, *sorted(DOCS.rglob("*.md"))], ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)`\s]+)\)", page.read_text(encoding="utf-8"))
    targets = [target.split("#")[0] for target in links if "://" not in target]
    assert [target for target in targets if target and not (page.parent / target).exists()] == []


def test_the_python_example_of_the_readme_runs(monkeypatch, capsys):
    monkeypatch.chdir(README.parent)
    (code,) = [block for kind, block in BLOCK.findall(README.read_text(encoding="utf-8")) if kind == "python"]
    exec(compile(code, "README.md", "exec"), {})
    assert "50 mm up: ok" in capsys.readouterr().out


def uneven(text: str) -> list[str]:
    """Rows of a page's tables with more or fewer cells than their header; a bar in a cell is one only as `\\|`."""
    wrong, wanted = [], 0
    for line, below in pairwise([*text.splitlines(), ""]):
        cells = len(re.findall(r"(?<!\\)\|", line)) - 1 if line.startswith("|") else 0
        wanted = cells if re.fullmatch(r"\|[-:| ]+\|", below) else wanted if cells else 0
        wrong += [line] if cells != wanted else []
    return wrong


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: str(page.relative_to(DOCS)))
def test_every_row_of_a_table_has_the_cells_of_its_header(page):
    assert uneven(page.read_text(encoding="utf-8")) == []


def test_a_row_with_a_cell_too_many_is_found():
    table = "| a | b |\n|---|---|\n| \\|x\\| | 2 |\n"
    assert uneven(table) == []
    assert uneven(table + "| |x| | 2 |\n") == ["| |x| | 2 |"]


def test_the_tutorial_is_for_a_real_machine():
    camera, rest = [block for kind, block in BLOCK.findall((DOCS / "tutorial.md").read_text()) if kind == "toml"]
    settings = ServerSettings.model_validate(tomllib.loads(rest + camera))  # one file, written in two steps
    assert settings.mode == "REAL"
    assert (settings.camera.kind, settings.http.keys_file) == ("device", "keys.json")
    assert (DOCS.parent / "machine" / "machines" / "hiab033.toml").exists()
