"""examples/06_diagnose.py on a recording of a machine with one slow valve."""

import subprocess
import sys
from pathlib import Path

import pytest
from diagnosis_cases import entry, folder, recording

ROOT = Path(__file__).parents[3]


@pytest.mark.slow
def test_a_recording_is_diagnosed_by_the_api(tmp_path):
    run = folder(tmp_path, recording(effects=(entry("valve_lag", 2, time_constant_s=0.2),)))
    command = [sys.executable, ROOT / "examples" / "06_diagnose.py", run]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    assert "verdict:" in done.stdout
