"""A stack of processes leaves nothing behind when the program that started it is told to end."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

WAIT_S = 20.0
PROGRAM = """
import subprocess, sys, time
from longreach.processes import Stack, StackPorts

class Sleeping(Stack):
    def start_sim(self):
        self.processes["sim"] = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"],
                                                 start_new_session=True)
    def start_server(self):
        pass

with Sleeping(StackPorts(1, 2, 3, 4)) as stack:
    print(stack.processes["sim"].pid, flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_what_a_stack_started_ends_with_its_program(tmp_path: Path, number: int) -> None:
    program = subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert program.stdout is not None
    with program, program.stdout:
        child = int(program.stdout.readline())
        program.send_signal(number)
        assert program.wait(WAIT_S) == -signal.SIGINT  # as by Ctrl-C
    until = time.monotonic() + WAIT_S
    while _runs(child) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _runs(child)


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
