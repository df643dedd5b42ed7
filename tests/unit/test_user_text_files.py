"""Text files of a user, as editors of Windows save them: a byte order mark is read over, other encodings are named."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from diagnosis.errors import DiagnosisError
from longreach.commission_operator import read_answers
from longreach.fleet_client import read_key as read_api_key
from machine.errors import MachineError
from recording.errors import RecordingError
from recording.folder import read_folder
from recording.machine_files import text_of_machine
from server.access.keys import read_keys
from server.camera.errors import CameraError
from server.camera.rectification_reading import read_calibration
from server.camera.sources.folder import EurocStereoSource
from server.camera.sources.settings import EurocSource
from server.errors import ServerError
from server.settings import read_machine_text, read_settings
from server.shell_settings import read_key as read_plc_key

ROOT = Path(__file__).parents[2]
EXPECTED = (ServerError, MachineError, RecordingError, DiagnosisError, CameraError)
KITTI = "".join(f"P{eye}: 700 0 600 {shift} 0 700 180 0 0 0 1 0\n" for eye, shift in ((0, 0), (1, -380)))


def run_of(path: Path) -> Any:
    return read_folder(path.parent).run_info


#: What it is called by the user: (file name, its text, what reads it).
FILES: dict[str, tuple[str, str, Callable[[Path], Any]]] = {
    "settings": ("settings.toml", 'mode = "SIM"  # größer\n[http]\nport = 8090\n', read_settings),
    "machine by the settings": ("machine.toml", "# größe\n[machine]\n", lambda path: read_machine_text(str(path))),
    "machine by a command": ("machine.toml", "# größe\n[machine]\n", text_of_machine),
    "keys": (
        "keys.json",
        '{"keys": [{"name": "jörg", "role": "operator", "sha256": "00", "made_unix_s": 1.0}]}',
        read_keys,
    ),
    "key of the PLC": ("plc.key", "ab" * 32 + "\n", lambda path: read_plc_key(str(path))),
    "API key": ("api.key", "longreach_abc\n", read_api_key),
    "answers": ("answers.toml", '[joint_signs]\nslew = "größer"\n', read_answers),
    "run": ("run.toml", '[run]\nname = "größer"\n', run_of),
    "calibration of the camera": (
        "calib.txt",
        KITTI,
        lambda path: read_calibration([str(path)], (1200, 360)).baseline_m,
    ),
}


def _said(read: Callable[[Path], Any], path: Path) -> str:
    with pytest.raises(EXPECTED) as refusal:
        read(path)
    return str(refusal.value)


@pytest.mark.parametrize("kind", FILES)
def test_a_byte_order_mark_and_ends_of_line_of_windows_change_nothing(tmp_path, kind):
    name, text, read = FILES[kind]
    (tmp_path / name).write_bytes(text.encode())
    plain = read(tmp_path / name)
    (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert str(read(tmp_path / name)) == str(plain)


@pytest.mark.parametrize("kind", FILES)
def test_utf_16_is_named_with_what_to_do(tmp_path, kind):
    name, text, read = FILES[kind]
    (tmp_path / name).write_bytes(text.encode("utf-16"))
    said = _said(read, tmp_path / name)
    assert "UTF-16" in said
    assert "save it as UTF-8" in said
    assert "\n" not in said


@pytest.mark.parametrize("kind", [kind for kind, (_, text, _) in FILES.items() if not text.isascii()])
def test_latin_1_is_named_with_line_and_byte(tmp_path, kind):
    name, text, read = FILES[kind]
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    said = _said(read, tmp_path / name)
    assert "line " in said
    assert "0xf6" in said
    assert "save it as UTF-8" in said


def test_the_list_of_a_data_set_too(tmp_path):
    eye = tmp_path / "cam0"
    eye.mkdir()
    (eye / "data.csv").write_bytes("#timestamp [ns],filename\n1,1.png\n".encode("utf-16"))
    (tmp_path / "cam1").mkdir()
    said = _said(lambda path: EurocStereoSource(EurocSource(str(path), 1.0)), tmp_path)
    assert "save it as UTF-8" in said


@pytest.mark.parametrize("option", ["--runs", "--keys", "--host", "--camera-url"])
def test_a_name_that_is_not_utf_8_is_refused_at_the_start_in_one_line(option):
    """Recordings hold the settings as UTF-8: nothing would be recorded."""
    made = subprocess.run(
        [sys.executable, "-m", "longreach.cli", "serve", option, b"http://a/runs\xff"],
        capture_output=True,
        cwd=ROOT,
    )
    assert (made.returncode, made.stdout) == (2, b"")
    said = made.stderr.decode()
    assert "longreach: command line: " in said
    assert "UTF-8" in said or "unicode" in said
    assert "Traceback" not in said
