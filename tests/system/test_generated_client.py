"""A typed client that a generator makes of our OpenAPI document alone takes control and gets a job done."""

import importlib
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from rest_stand import served

GENERATOR = Path(sys.executable).with_name("openapi-python-client")
NAME = "generated_longreach_client"
WAIT_S = 20.0
pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not GENERATOR.exists(), reason="openapi-python-client is not installed"),
]


@pytest.fixture
def stand(tmp_path):
    with served(tmp_path) as (url, made):
        yield url, made


@pytest.fixture
def client(tmp_path, stand, monkeypatch):
    """The generated package, and a client with an operator's key."""
    url, made = stand
    document = tmp_path / "openapi.json"
    document.write_text(json.dumps(made.app.openapi()), encoding="utf-8")
    command = [GENERATOR, "generate", "--path", document, "--output-path", tmp_path / NAME, "--meta", "none"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    left_out = [line for line in done.stdout.splitlines() if line.startswith("WARNING")]
    assert all("camera.jpg" in line or "/pictures/" in line for line in left_out), left_out  # pictures are no models
    monkeypatch.syspath_prepend(str(tmp_path))
    package = importlib.import_module(NAME)
    with package.AuthenticatedClient(base_url=url, token=made.keys["operator"]) as made_client:
        yield made_client
    for loaded in [one for one in sys.modules if one.split(".")[0] == NAME]:
        del sys.modules[loaded]


def call(path: str):
    """A function module of the generated client, such as `jobs.start_job`."""
    return importlib.import_module(f"{NAME}.api.{path}")


def test_it_takes_control_gets_a_job_to_its_end_and_gives_control_back(client):
    models = importlib.import_module(f"{NAME}.models")
    lease = call("lease.acquire").sync(client=client, body=models.LeaseRequest(owner="generated", ttl_s=30.0))
    assert isinstance(lease, models.LeaseView)
    proof = {"longreach_lease": lease.lease_id, "longreach_fencing": lease.fencing, "idempotency_key": "first"}
    job = call("jobs.start_job").sync(client=client, body=models.LookRequest(kind="look"), **proof)
    assert isinstance(job, models.JobView)
    until_s = time.monotonic() + WAIT_S
    while job.state in ("running", "stopping") and time.monotonic() < until_s:
        time.sleep(0.05)
        job = call("jobs.read_job").sync(client=client, job_id=job.job_id)
    assert (job.state, job.code) == ("failed", "stand_in")  # there is no machine behind this stand
    assert [event.name for event in job.events][-1] == "ended"
    assert call("lease.release").sync_detailed(client=client, lease_id=lease.lease_id).status_code == 204


def test_a_refusal_comes_as_a_typed_problem(client):
    models = importlib.import_module(f"{NAME}.models")
    refused = call("jobs.start_job").sync(client=client, body=models.LookRequest(kind="look"))
    assert isinstance(refused, models.Problem)
    assert refused.code == "no_lease"
    assert refused.hint
