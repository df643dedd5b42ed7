"""Lines of long runs, and what a kill in the midst of one leaves of them. Nothing here runs long."""

import json
import logging

import pytest

from benchmarks.saved_lines import SavedLineError, add_line, every_line, open_to_add, read_lines, whole_lines

WHOLE = b'{"key": 1}\n{"key": 2}\n'
CUT = b'{"key": 3, "name": "'


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cases.jsonl"


@pytest.mark.parametrize("read", [every_line, whole_lines, lambda path: list(read_lines(path).values())])
@pytest.mark.parametrize("cut", [CUT, b"{", CUT + "\u00e9".encode()[:1], b"\x00\x00"])
def test_a_last_line_cut_short_is_told_and_left_out(path, caplog, read, cut):
    path.write_bytes(WHOLE + cut)
    assert read(path) == [{"key": 1}, {"key": 2}]
    assert [record.getMessage() for record in caplog.records] == [
        f"{path}, line 3: cut short by a kill; left out, to run again"
    ]


@pytest.mark.parametrize("read", [every_line, whole_lines, read_lines])
def test_what_is_whole_is_read_in_silence(path, caplog, read):
    assert not read(path)  # not there yet
    path.write_bytes(b"")
    assert not read(path)
    path.write_bytes(WHOLE + b'\n{"key": 3}')  # a blank line; and the kill came before the end of the line only
    assert len(read(path)) == 3
    assert caplog.records == []


def test_a_line_in_the_midst_is_an_error_or_told_and_left_out(path, caplog):
    path.write_bytes(b'{"key": 1}\n{"ke\n{"key": 3}\n[]\n')
    for strict in (every_line, read_lines):
        with pytest.raises(SavedLineError, match=r"line 2: JSONDecodeError.*; remove the line"):
            strict(path)
    assert caplog.records == []
    assert whole_lines(path, lambda text: json.loads(text)["key"]) == [1, 3]
    (told,) = caplog.records
    assert told.levelno == logging.WARNING
    assert "line 2 (and 1 more): left out, to run again: JSONDecodeError" in told.getMessage()


def test_a_whole_last_line_of_another_version_is_no_cut_one(path):
    path.write_bytes(WHOLE + b'{"other": 3}')
    with pytest.raises(SavedLineError, match="line 3: KeyError"):
        read_lines(path)


@pytest.mark.parametrize("end", [b"", CUT, CUT + "\u00e9".encode()[:1], b'{"key": 3}'])
def test_the_next_line_does_not_hang_on_to_a_cut_one(path, end):
    path.write_bytes(WHOLE + end)
    with open_to_add(path) as file:
        add_line(file, {"key": 4})
    kept = WHOLE + (end + b"\n" if end.endswith(b"}") else b"") + b'{"key": 4}\n'
    assert path.read_bytes() == kept


def test_the_first_line_makes_file_and_folder(tmp_path):
    path = tmp_path / "new" / "cases.jsonl"
    with open_to_add(path) as file:
        add_line(file, {"key": 1})
        assert path.read_bytes() == b'{"key": 1}\n'  # at once, not when the run ends
