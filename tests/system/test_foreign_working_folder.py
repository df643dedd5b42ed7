"""Started in a folder whose files have the names of our packages and of others': everything runs as elsewhere."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from longreach.fleet_client import JobClient
from longreach.processes import free_port

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(3600)]
ROOT = Path(__file__).parents[2]
NAMES = ("machine", "server", "web", "numpy", "recording", "protocol", "sim_plc", "diagnosis", "random", "selectors")
IMPORTED = "a file of the working folder was imported"
READY_S = 600.0  # on a busy computer


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("foreign")
    for name in NAMES:
        (made / f"{name}.py").write_text(f"raise SystemExit('{IMPORTED}')\n", encoding="utf-8")
    return made


def command(*arguments):
    return [sys.executable, "-m", "longreach", *arguments]


def surroundings():
    return {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}


def run(folder, *arguments):
    done = subprocess.run(
        command(*arguments), cwd=folder, env=surroundings(), capture_output=True, text=True, timeout=1800, check=False
    )
    assert IMPORTED not in done.stdout + done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    return done


@pytest.fixture(scope="module")
def recordings(folder):
    """The demo, which starts simulator and server, is ready, moves once, and is ended."""
    port = free_port()
    log = (folder / "demo.log").open("wb")
    started = command("demo", "--no-browser", "--port", str(port))
    with subprocess.Popen(started, cwd=folder, env=surroundings(), stdout=log, stderr=subprocess.STDOUT) as demo:
        try:
            with JobClient(f"http://127.0.0.1:{port}") as client:
                client.wait_ready(READY_S, lambda _waited_s, why: still_running(demo, why))
                moved = client.run({"kind": "retract", "distance_mm": 50.0})
        finally:
            demo.send_signal(signal.SIGINT)
            demo.wait(60.0)
    log.close()
    logs = [*folder.rglob("*.log")]
    assert len(logs) >= 3  # of the demo, the simulator and the server
    for file in logs:
        text = file.read_text(encoding="utf-8", errors="replace")
        assert IMPORTED not in text, file
        assert "Traceback" not in text, file
    assert moved.state == "done", moved
    found = sorted((folder / "runs" / "realistic-1").glob("*.mcap"))
    assert found
    return found


def still_running(demo, why):
    assert demo.poll() is None, why


def test_the_demo_starts_moves_and_ends(recordings):
    assert recordings


def test_its_recording_is_checked_and_diagnosed(folder, recordings):
    assert run(folder, "recording", "check", str(recordings[0])).returncode == 0
    done = run(folder, "diagnose", str(recordings[0]))
    assert done.returncode in (0, 2), done.stderr  # 2: it says why this short recording cannot be diagnosed


def test_simulator_and_server_by_themselves(folder):
    for arguments in (("sim", "--help"), ("serve", "--help"), ("serve", "--settings", "none.toml")):
        done = run(folder, *arguments)
        assert done.returncode == (2 if "none.toml" in arguments else 0), done.stderr
