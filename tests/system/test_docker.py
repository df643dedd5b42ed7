"""The containers, built and used from nothing: minutes, and root; `make test-slow` runs it."""

import os
import subprocess
from pathlib import Path

import pytest

CHECK = Path(__file__).parents[2] / "docker" / "check.sh"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.system,
    pytest.mark.timeout(1500),
    pytest.mark.skipif(os.geteuid() != 0, reason="docker/check.sh starts an engine of its own, which needs root"),
]


def test_compose_comes_up_and_positions_the_tool():
    done = subprocess.run(["bash", str(CHECK)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert "docker check passed" in done.stdout
