"""A first start, which compiles for minutes, ended by a terminal: impatient Ctrl-C, or its closing."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from longreach.processes import free_port

pytestmark = [
    pytest.mark.system,
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc"),
]
BEGINS_S, ENDS_S = 300.0, 45.0  # a compilation is under way; the rest of it takes minutes of a computer that is free
PAUSE_S = 0.3


@pytest.mark.parametrize(("number", "times"), [(signal.SIGINT, 4), (signal.SIGTERM, 1), (signal.SIGHUP, 1)])
def test_a_demo_that_compiles_ends_and_leaves_no_process(tmp_path, number, times):
    cache = tmp_path / "cache"
    cache.mkdir()
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-P", "-m", "longreach", "demo", "--no-browser", "--port", str(free_port())]
    demo = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, start_new_session=True)
    try:
        until_s = time.monotonic() + BEGINS_S
        while not list(cache.rglob("*.nbi")):
            assert demo.poll() is None
            assert time.monotonic() < until_s
            time.sleep(PAUSE_S)
        for _ in range(times):
            if demo.poll() is None:
                os.killpg(demo.pid, number) if number == signal.SIGINT else demo.send_signal(number)
            time.sleep(PAUSE_S)
        assert demo.wait(ENDS_S) == 128 + number
        assert not processes_in(cache)
    finally:
        for pid in {demo.pid, *processes_in(cache)}:
            subprocess.run(["kill", "-KILL", str(pid)], check=False, stderr=subprocess.DEVNULL)
        demo.communicate()


def processes_in(cache: Path) -> list[int]:
    """Those that compile into that folder: the demo itself and what it started."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and f"NUMBA_CACHE_DIR={cache}".encode() in (entry / "environ").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue  # it has ended
    return found
