"""The Python API and its examples: every name resolves, is documented, and every script runs."""

import json
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

import longreach

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path.name for path in (ROOT / "examples").glob("*.py"))
SAYS = {
    "01_machine_file.py": "camera: 1280 x 720 px",
    "02_kinematics.py": "joints change by",
    "03_marker_pose.py": "mm from where it was drawn",
    "04_plc_link.py": "the PLC is in HOLD",
    "05_recording.py": "200 PLC states",
    "06_diagnose.py": "verdict:",  # by tests/unit/diagnosis/test_diagnose_example.py
    "07_rest_client.py": "mode: SIM",
    "08_effects.py": "valve_deadband",
}


def said_by(name, *arguments):
    done = subprocess.run(
        [sys.executable, "-W", "error", ROOT / "examples" / name, *map(str, arguments)],
        cwd=ROOT,
        env={"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "HOME": str(Path.home()), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_is_run_here():
    assert list(SAYS) == SCRIPTS


@pytest.mark.parametrize("name", [name for name in SCRIPTS if not name.startswith(("06", "07"))])
def test_an_example_runs(name):
    assert SAYS[name] in said_by(name)


class StandIn(BaseHTTPRequestHandler):
    """As much of a server as the client asks for up to a refused job."""

    def answer(self, status, body):
        data = json.dumps(body).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def do_GET(self):
        self.answer(200, {"mode": "SIM", "look": None})

    def do_POST(self):
        self.answer(409, {"title": "Busy", "status": 409, "detail": "position of fleet 1 is running", "code": "busy"})

    def log_message(self, format, *args):
        pass


def test_the_rest_example_reaches_a_server():
    with ThreadingHTTPServer(("127.0.0.1", 0), StandIn) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with pytest.raises(AssertionError, match="position of fleet 1 is running") as refused:
            said_by("07_rest_client.py", f"http://127.0.0.1:{server.server_port}")
        server.shutdown()
    assert "JobRefusedError" in str(refused.value)


@pytest.mark.parametrize("name", longreach.__all__)
def test_a_name_of_the_api_resolves_and_is_documented(name):
    assert getattr(longreach, name) is not None
    assert f"`{name}" in (ROOT / "docs" / "python-api.md").read_text(encoding="utf-8")


def test_an_unknown_name_points_to_the_list():
    with pytest.raises(AttributeError, match="python-api"):
        longreach.frobnicate  # noqa: B018
