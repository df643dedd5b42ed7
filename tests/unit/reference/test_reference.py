"""docs/reference.md is what the code is."""

from pathlib import Path

import pytest

from longreach.settings_command import type_text
from protocol.codes import FaultBit, RejectCode
from server.api.panel_alarm_catalogue import CATALOGUE
from server.settings import ServerSettings
from tools.reference import document, reference, table

PAGE = Path(__file__).parents[3] / "docs" / "reference.md"


@pytest.fixture(scope="module")
def text() -> str:
    return reference()


def test_the_page_is_current(text):
    assert PAGE.read_text(encoding="utf-8") == text, "run `python -m tools.reference`"


def test_everything_is_in_it(text):
    operations = [f"`{method.upper()} {path}`" for path, ops in document()["paths"].items() for method in ops]
    assert len(operations) > 40
    names = [*operations, *(f"`{one.name}`" for one in (*RejectCode, *FaultBit)), *(f"`{code}`" for code in CATALOGUE)]
    names += [f"| `{name}` |" for name in ServerSettings().position.model_dump()]
    names += ["### longreach serve", "### longreach recording check", "### [http]"]
    assert [name for name in names if name not in text] == []


@pytest.mark.parametrize(
    ("annotation", "told"),
    [(int, "whole number"), (str | None, "text"), (list[str], "list of text"), (float | str, "number or text")],
)
def test_types_are_told_in_words(annotation, told):
    assert type_text(annotation) == told


def test_a_cell_stays_one_cell():
    assert table(("a", "b"), [("x | y", "two\nlines")]) == "| a | b |\n| --- | --- |\n| x \\| y | two lines |"
