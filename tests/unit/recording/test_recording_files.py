"""Files of this computer: what survives a power cut, and text of editors that do not write plain UTF-8."""

import ast
import os
import stat
from pathlib import Path

import pytest

from recording.files import EncodingError, read_text, write_durably

ROOT = Path(__file__).parents[3]
PACKAGES = ("longreach", "server", "web", "diagnosis", "sim_plc", "machine", "recording", "protocol")
SETS_ASIDE = "longreach/diagnose_command.py"  # gives an earlier run's file another name; it writes none


@pytest.fixture
def steps(monkeypatch):
    """What is asked of the operating system, in its order: fsync of a file or a folder, and the rename."""
    found, sync, rename = [], os.fsync, os.replace

    def synced(descriptor):
        found.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        sync(descriptor)

    def renamed(*args, **kwargs):
        found.append("rename")
        rename(*args, **kwargs)

    monkeypatch.setattr("os.fsync", synced)
    monkeypatch.setattr("os.replace", renamed)
    return found


def test_a_file_is_on_disk_before_its_name_and_its_name_before_the_return(tmp_path, steps):
    write_durably(tmp_path / "keys.json", "new")
    assert steps == ["file", "rename", "folder"]
    assert (tmp_path / "keys.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["keys.json"]


def test_a_disk_that_does_not_take_it_leaves_the_file_of_before(tmp_path, monkeypatch):
    def full(_descriptor):
        raise OSError(28, "No space left on device")

    file = tmp_path / "calibration.json"
    file.write_text("old")
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_durably(file, "new")
    assert file.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["calibration.json"]


def test_a_link_stays_a_link_and_a_pipe_a_pipe(tmp_path):
    (tmp_path / "real.json").write_text("old")
    (tmp_path / "keys.json").symlink_to("real.json")
    write_durably(tmp_path / "keys.json", "new")
    assert (tmp_path / "keys.json").is_symlink()
    assert (tmp_path / "real.json").read_text() == "new"
    os.mkfifo(tmp_path / "out")
    reading = os.open(tmp_path / "out", os.O_RDONLY | os.O_NONBLOCK)
    write_durably(tmp_path / "out", "through")
    assert os.read(reading, 20) == b"through"
    os.close(reading)


def test_only_a_private_file_is_hidden_from_others(tmp_path):
    umask = os.umask(0o022)
    try:
        write_durably(tmp_path / "report.json", "{}")
        write_durably(tmp_path / "key", "secret", private=True)
    finally:
        os.umask(umask)
    assert stat.S_IMODE((tmp_path / "report.json").stat().st_mode) == 0o644
    assert stat.S_IMODE((tmp_path / "key").stat().st_mode) == 0o600


def test_no_other_code_puts_a_file_in_the_place_of_another():
    def renames(file):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                owner = node.func.value.id if isinstance(node.func.value, ast.Name) else ""
                count = 2 if owner == "os" else 1  # text.replace takes two, dataclasses' and datetime's take names
                if node.func.attr in ("replace", "rename") and len(node.args) == count and not node.keywords:
                    yield f"{file.relative_to(ROOT)}"

    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    assert len(files) > 500
    assert {place for file in files for place in renames(file)} == {"recording/files.py", SETS_ASIDE}


@pytest.mark.parametrize("text", ["größe = 1\n", "a = 1\nb = 2\n", ""])
def test_text_of_windows_editors_is_read(tmp_path, text):
    file = tmp_path / "settings.toml"
    file.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert read_text(file) == text


@pytest.mark.parametrize(
    ("data", "why"),
    [
        ("a = 1".encode("utf-16"), "UTF-16"),
        ("a = 1".encode("utf-16-be"), "UTF-16"),
        ("a = 1".encode("utf-16-le"), "UTF-16"),
        ("a = 1\n# größe".encode("latin-1"), "line 2 holds byte 0xf6"),
    ],
)
def test_other_text_is_refused_with_what_to_do(tmp_path, data, why):
    file = tmp_path / "settings.toml"
    file.write_bytes(data)
    with pytest.raises(EncodingError, match=why) as refusal:
        read_text(file)
    assert "save it as UTF-8" in refusal.value.strerror
