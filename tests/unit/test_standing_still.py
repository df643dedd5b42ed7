"""A failure while the computer stood still is run again, and told; any other failure is one."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.standing_still import StandstillWatch, longest_s

TESTS = Path(__file__).parents[1]
FAILS_ONCE = """
import time
from pathlib import Path
import psutil

def test_it():
    again = Path("again")
    if again.exists():
        return
    again.touch()
    for child in psutil.Process().children():
        {pause}
    assert False
"""


def test_the_longest_standstill_since_a_moment() -> None:
    noted = ["1.0 1.2", "5.0 5.5", "7.0 7.1", "9.0"]
    assert longest_s(noted, 0.0) == pytest.approx(0.5)
    assert longest_s(noted, 6.0) == pytest.approx(0.1)
    assert longest_s(noted, 8.0) == 0.0


def test_a_process_that_was_stopped_is_noted() -> None:
    begun_s, watch = time.monotonic(), StandstillWatch()
    try:
        deadline_s = begun_s + 20.0
        while watch.longest_s(begun_s) <= 0.2 and time.monotonic() < deadline_s:
            watch.pid_signal(signal.SIGSTOP)
            time.sleep(0.3)
            watch.pid_signal(signal.SIGCONT)
            time.sleep(0.1)
        assert watch.longest_s(begun_s) > 0.2
    finally:
        watch.close()


def test_a_failure_in_such_a_moment_is_run_again_and_told(tmp_path: Path) -> None:
    run = _run(tmp_path, "time.sleep(0.5), child.suspend(), time.sleep(0.4), child.resume(), time.sleep(0.5)")
    assert run.returncode == 0, run.stdout
    assert "run again" in run.stdout


def test_a_failure_outside_the_folders_of_real_time_is_one(tmp_path: Path) -> None:
    run = _run(tmp_path, "pass", folder="unit")
    assert run.returncode == 1, run.stdout
    assert "run again" not in run.stdout


def _run(place: Path, pause: str, folder: str = "loop") -> "subprocess.CompletedProcess[str]":
    (place / "tests" / folder).mkdir(parents=True)
    (place / "tests" / "conftest.py").write_text((TESTS / "conftest.py").read_text())
    (place / "tests" / folder / "test_once.py").write_text(FAILS_ONCE.format(pause=pause))
    (place / "pytest.ini").write_text("[pytest]\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    path = {**os.environ, "PYTHONPATH": str(TESTS.parent)}
    return subprocess.run(command, cwd=place, env=path, capture_output=True, text=True, check=False, timeout=120)
