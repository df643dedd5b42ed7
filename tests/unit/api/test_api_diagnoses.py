"""Diagnoses over REST: several recordings together, and one waiting for its turn behind another. No real diagnosis."""

import asyncio
import sys

import pytest

from server.access.lease import LeaseKind
from server.access.roles import Caller
from server.api.hold_rule import HoldRequiredError, require_hold
from server.errors import BusyError
from server.jobs.diagnosing import Diagnoses
from server.jobs.request_bodies import IdentifyRequest, PlanIdentifyRequest

SAY = "import json, sys, pathlib; a = sys.argv; pathlib.Path(a[a.index('--json') + 1]).write_text(json.dumps(a[1:]))"
WAIT = "import time; time.sleep(60)"


def standing_in(folder, code):
    """Diagnoses whose command is a line of Python."""
    return Diagnoses(folder, (sys.executable, "-c", code))


async def test_all_recordings_are_handed_to_one_diagnosis(tmp_path):
    diagnoses = standing_in(tmp_path, SAY)
    one = diagnoses.start(tmp_path / "a.mcap", tmp_path / "b.mcap")
    await asyncio.wait({one.task})
    assert one.state == "done", one.reason
    assert diagnoses.result(one)[:2] == [str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap")]
    assert one.recording == "a.mcap"


async def test_one_waits_for_another_and_a_third_is_refused(tmp_path):
    diagnoses = standing_in(tmp_path, WAIT)
    first = diagnoses.start(tmp_path / "a.mcap")
    second = diagnoses.queue_diagnosis((tmp_path / "a.mcap", tmp_path / "b.mcap"), "job")
    assert (first.state, second.state, second.job_id) == ("running", "waiting", "job")
    with pytest.raises(BusyError):
        diagnoses.start(tmp_path / "c.mcap")
    await asyncio.sleep(0)
    assert second.state == "waiting"
    await diagnoses.stop(first)
    assert first.state == "stopped"
    for _ in range(1000):
        if second.state == "running":
            break
        await asyncio.sleep(0.001)
    assert second.state == "running"
    await diagnoses.close()
    assert second.state == "stopped"


async def test_one_that_is_stopped_before_its_first_step_has_ended(tmp_path):
    diagnoses = standing_in(tmp_path, WAIT)
    one = diagnoses.start(tmp_path / "a.mcap")
    await diagnoses.stop(one)
    assert one.state == "stopped"
    assert diagnoses.start(tmp_path / "b.mcap").state == "running"
    await diagnoses.close()


async def test_several_runs_by_rest(open_bench, tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(Diagnoses, "_start_diagnosis", lambda self, one: started.append(one) or one)
    for name in ("a", "b"):
        (tmp_path / "runs" / f"{name}.mcap").write_bytes(b"")
    async with open_bench.client() as client:
        answer = await client.post("/v1/diagnoses", json={"run_ids": ["a", "b"]})
        assert answer.status_code == 202
        assert answer.json()["recordings"] == ["a.mcap", "b.mcap"]
        for body, status in (({"run_ids": ["a", "none"]}, 404), ({"run_ids": ["a"]}, 422), ({"run_ids": "ab"}, 422)):
            assert (await client.post("/v1/diagnoses", json=body)).status_code == status
        unknown = await client.post("/v1/diagnoses", json={"run_ids": ["a", "none"]})
        assert "'none'" in unknown.json()["detail"]
        assert "'a'" not in unknown.json()["detail"]
    assert [path.name for path in started[0].recordings] == ["a.mcap", "b.mcap"]


def test_on_a_real_machine_an_operator_holds_the_button_for_an_identification(open_bench):
    body = IdentifyRequest(kind="identify", plan_hash="0" * 16)
    operator = open_bench.service.engine.leases.acquire("anna", LeaseKind.OPERATOR, 60.0)
    with pytest.raises(HoldRequiredError):
        require_hold("REAL", body, operator, Caller())
    require_hold("SIM", body, operator, Caller())


def test_planning_an_identification_needs_no_hand(open_bench):
    operator = open_bench.service.engine.leases.acquire("anna", LeaseKind.OPERATOR, 60.0)
    require_hold("REAL", PlanIdentifyRequest(kind="plan_identify"), operator, Caller())


def test_the_jobs_diagnoses_are_those_that_rest_lists(open_bench):
    assert open_bench.running.diagnoses is open_bench.service.diagnoses
