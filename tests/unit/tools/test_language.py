"""The language lint: what it finds, and what it leaves alone."""

import pytest

from tools import language


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("the PLC told us", "told"),
        ("def _told(names):", "told"),
        ("for one in markers:", "for one in"),
        ("[one.t for k, one in found]", "for k, one in"),
        ("the path is no file", "is no"),
        ("Nobody has control", "Nobody"),
    ],
)
def test_a_word_of_the_list_is_found_in_prose_and_identifiers(line: str, found: str):
    ((number, message),) = language.words_in(line)
    assert number == 1
    assert message.startswith(f"'{found}' -> ")


@pytest.mark.parametrize(
    "line",
    [
        "x is None",
        "there is no marker",
        "it is no longer valid",
        "it is no further than a cycle",
        "for marker in markers:",
        "the block swapped",
    ],
)
def test_ordinary_words_pass(line: str):
    assert list(language.words_in(line)) == []


def test_long_lines_and_sentences_are_found_in_docs_only():
    text = "word " * 41 + "\n"
    found = [finding.text for finding in language.findings_in("docs/page.md", text)]
    assert [message.partition(" of ")[0] for message in found] == ["line", "sentence"]
    assert language.findings_in("server/page.py", f"# {text}") == []


def test_code_blocks_may_be_long_and_table_rows_longer_than_lines():
    row = "| " + "x" * 200 + " |"
    assert language.findings_in("docs/page.md", f"```\n{'x ' * 200}\n```\n\n{row}\n") == []


@pytest.mark.parametrize("end", [".", ".**", ".)", ":"])
def test_a_sentence_may_end_in_bold_or_in_brackets(end: str):
    text = f"{'word ' * 30}word{end} {'word ' * 30}\n"
    assert list(language.long_sentences_in(text)) == []
    assert len(list(language.long_sentences_in(text.replace(f"{end} ", ", ")))) == 1


def test_a_docstring_that_describes_a_field_by_an_old_name_is_found():
    text = 'class Fit:\n    """A fit. `rms`: of its rows. `n`, `sigma`: as given."""\n\n    rms: float\n    n: int\n'
    assert list(language.names_gone_in(text)) == [(2, "`sigma` is described -> a name of this module")]
    assert list(language.names_gone_in(text.replace("`sigma`", "`rms`"))) == []
