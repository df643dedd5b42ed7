"""One whole run over real UDP and rendered images, and what happens when something is missing."""

import contextlib
import time

import httpx
import pytest

from benchmarks.positioning.end_to_end import join_truth, read_truth
from longreach.fleet_client import JobClient, JobRefusedError
from longreach.processes import Stack, StackPorts
from recording.opening import read_run
from recording.rows import PlcState, Sent

pytestmark = [pytest.mark.system, pytest.mark.timeout(420)]
READY_S = 180.0


def positioned(folder):
    """A whole run in this folder: (the finished job, what it told on the way)."""
    stack = Stack(
        StackPorts.free(),
        seed=3,
        camera_rate_hz=10.0,
        truth_log=folder / "truth",
        runs_folder=folder / "runs",
        log_folder=folder / "logs",
    )
    with stack, JobClient(stack.url) as client:
        client.wait_ready(READY_S)
        told = []
        finished = client.run({"kind": "position", "owner": "test"}, told.append)
    return finished, told


@pytest.mark.real_time
def test_position_ends_inside_tolerance_truly_and_leaves_a_recording(tmp_path):
    finished, told = positioned(tmp_path)
    assert finished.state == "done", finished.reason
    assert finished.result["reached"], finished.result["reason"]
    last = join_truth(finished.result, read_truth(tmp_path / "truth" / "truth.csv"))[-1]
    assert max(abs(value) for value in last.true_mm) <= 5.0
    assert last.true_deg <= 1.0
    assert any(event["name"] == "calibrate" for event in told)
    recordings = list((tmp_path / "runs").glob("*.mcap"))
    assert len(recordings) == 1
    run = read_run(recordings[0])
    assert run.complete
    assert 'name = "hiab033"' in run.machine_toml
    assert len(run.of(PlcState)) > 1000  # 100 Hz over the whole run
    assert run.of(Sent) == ()  # when a played trajectory was handed over says nothing of the link


def wait_started(url):
    """Until the server no longer loads its numerics: what is missing besides is stated then."""
    end_s = time.monotonic() + READY_S
    while time.monotonic() < end_s:
        with contextlib.suppress(httpx.TransportError):
            if "numerics" not in httpx.get(f"{url}/readyz").text:
                return
        time.sleep(0.5)


def test_without_plc_and_camera_it_says_so_and_nothing_starts(tmp_path):
    stack = Stack(StackPorts.free(), runs_folder=tmp_path / "runs", log_folder=tmp_path / "logs")
    stack.start_server()
    try:
        with JobClient(stack.url) as client:
            wait_started(stack.url)
            with pytest.raises(JobRefusedError, match="PLC does not answer"):
                client.wait_ready(12.0)
        with httpx.Client(base_url=stack.url) as http:
            assert http.post("/v1/jobs", json={"kind": "position"}).json()["code"] == "no_lease"
            lease = http.post("/v1/lease", json={"owner": "test", "ttl_s": 60.0}).json()
            http.headers.update({"Longreach-Lease": lease["lease_id"], "Longreach-Fencing": str(lease["fencing"])})
            job = http.post("/v1/jobs", json={"kind": "position"}).json()
            ended = client_wait(http, job["job_id"])
            assert ended["state"] == "failed"
            assert "check cable, PLC program" in ended["reason"]
            wrong = http.post("/v1/jobs", json={"kind": "execute", "plan_hash": "0" * 16})
            assert wrong.status_code == 409
            assert "preview first" in wrong.json()["detail"]
            assert http.post("/v1/jobs", json={"kind": "fly"}).status_code == 422
    finally:
        stack.close()


def client_wait(http, job_id):
    with http.stream("GET", f"/v1/jobs/{job_id}/events", timeout=20.0) as story:
        for line in story.iter_lines():
            if line == "event: end":
                break
    return http.get(f"/v1/jobs/{job_id}").json()
