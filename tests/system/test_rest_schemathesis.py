"""Requests made from our own OpenAPI document by schemathesis, by every role: no 5xx, nothing undocumented, and no job
without control. LONGREACH_SCHEMATHESIS_N sets the examples per operation of the slow test (default 40).

Left out: /v1/events (a stream without end), /readyz and /v1/camera.jpg (503 by contract: there is no camera here).
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from longreach.fleet_client import LeaseHolder

sys.path.insert(0, str(Path(__file__).parent))
from rest_stand import served

SCHEMATHESIS = Path(sys.executable).with_name("schemathesis")
CONFIG = Path(__file__).with_name("schemathesis.toml")
LEFT_OUT = ("/v1/events", "/readyz", "/v1/camera.jpg")
COUNT = re.compile(r"(\d+) generated")
pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(shutil.which(str(SCHEMATHESIS)) is None, reason="schemathesis is not installed"),
]


def run(url: str, key: str, *options: str) -> tuple[int, str]:
    """Cases made, and what it said; fails on any finding."""
    command = [
        str(SCHEMATHESIS),
        "--config-file",
        str(CONFIG),
        "run",
        f"{url}/v1/openapi.json",
        "--no-color",
        "--seed",
        "1",
        "--request-timeout",
        "10",
    ]
    command += ["-H", f"Authorization: Bearer {key}", *options]
    for path in LEFT_OUT:
        command += ["--exclude-path", path]
    environment = {**os.environ, "SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(Path(__file__).parent)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-1000:]
    counted = COUNT.search(done.stdout)
    return int(counted.group(1)) if counted else 0, done.stdout


def jobs_of(made):
    """(fencing, role) of every job that was ever begun."""
    query = "SELECT jobs.fencing, audit.role FROM jobs JOIN audit USING (job_id) WHERE audit.outcome = 'accepted'"
    return made.keeper.database.read(lambda db: [tuple(row) for row in db.execute(query)])


def keyed(url: str, key: str) -> httpx.Client:
    """A client that says its key."""
    return httpx.Client(base_url=url, headers={"Authorization": f"Bearer {key}"}, timeout=10.0)


def outcomes_of(made):
    """How many commands were answered how."""
    query = "SELECT outcome, count(*) FROM audit GROUP BY outcome"
    return made.keeper.database.read(lambda db: dict(db.execute(query).fetchall()))


def test_one_request_of_each_kind_is_answered_as_documented(tmp_path):
    with served(tmp_path) as (url, made):
        cases, _ = run(url, made.keys["operator"], "--phases", "fuzzing", "--max-examples", "1")
        assert cases >= 37
        assert all(fencing > 0 for fencing, _ in jobs_of(made))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("role", ["operator", "fleet", "engineer", "admin"])
def test_whatever_the_holder_of_control_sends_is_answered_as_documented(tmp_path, role):
    """Random links rarely lead to a job: here control is held and kept, so that commands get past the guard."""
    kind = "fleet" if role == "fleet" else "operator"
    with served(tmp_path) as (url, made), keyed(url, made.keys[role]) as http, LeaseHolder(http, role, kind) as holder:
        proofs = [part for name, value in holder.headers.items() for part in ("-H", f"{name}: {value}")]
        # /take would end this control; and our proofs stand in place of the wrong ones that it makes
        left_out = ("--exclude-path", "/v1/lease/take", "--exclude-checks", "negative_data_rejection")
        cases, _ = run(url, made.keys[role], *proofs, *left_out, "--phases", "coverage,fuzzing")
        begun = jobs_of(made)
        print(f"{role} in control: {cases} cases, {len(begun)} jobs begun, {outcomes_of(made)}")
        assert begun
        assert {fencing for fencing, _ in begun} == {int(holder.headers["Longreach-Fencing"])}


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("role", ["viewer", "operator", "fleet", "engineer", "admin"])
def test_whatever_a_role_sends_is_answered_as_documented_and_moves_nothing_without_control(tmp_path, role):
    examples = os.environ.get("LONGREACH_SCHEMATHESIS_N", "40")
    with served(tmp_path) as (url, made):
        cases, _ = run(
            url, made.keys[role], "--phases", "examples,coverage,fuzzing,stateful", "--max-examples", examples
        )
        begun = jobs_of(made)
        print(f"{role}: {cases} cases, {len(begun)} jobs begun, {outcomes_of(made)}")
        assert cases >= 2000 or int(examples) < 30, "five roles together: 10,000 cases"
        assert all(fencing > 0 for fencing, _ in begun)
        assert role != "viewer" or (not begun and not made.performer.performed)
