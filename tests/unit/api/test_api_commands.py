"""Commands that a fleet can trust: keys, retries, expiry, cancel, audit; and nothing moves that is not written down."""

import asyncio
import time
from urllib.parse import urljoin

import pytest

from recording.clock import mono_ns
from server.jobs.engine import JobState
from server.store.audit_rows import add_plan

PARK = {"kind": "park"}


async def leased(client, owner="truck 7", kind="fleet"):
    lease = (await client.post("/v1/lease", json={"owner": owner, "kind": kind, "ttl_s": 60.0})).json()
    return {"Longreach-Lease": lease["lease_id"], "Longreach-Fencing": str(lease["fencing"])}


async def test_a_retry_with_its_key_is_answered_and_not_carried_out_again(open_bench):
    async with open_bench.client() as client:
        headers = await leased(client) | {"Idempotency-Key": "k1"}
        first = await client.post("/v1/jobs", json=PARK, headers=headers)
        assert first.status_code == 202
        await open_bench.settled()
        again = await client.post("/v1/jobs", json=PARK, headers=headers)
        spaced = await client.post(
            "/v1/jobs", content=b'{ "kind" : "park" }', headers=headers | {"Content-Type": "application/json"}
        )
    assert (again.status_code, again.text, again.headers["location"]) == (202, first.text, first.headers["location"])
    assert spaced.text == first.text
    assert len(open_bench.service.engine.jobs) == 1


async def test_a_retry_is_answered_also_after_control_was_lost_and_after_a_restart(open_bench, tmp_path):
    from served import bench

    async with open_bench.client() as client:
        headers = await leased(client) | {"Idempotency-Key": "k1"}
        first = await client.post("/v1/jobs", json=PARK, headers=headers)
        await open_bench.settled()
        await client.delete(f"/v1/lease/{headers['Longreach-Lease']}")
        assert (await client.post("/v1/jobs", json=PARK, headers=headers)).text == first.text
    open_bench.keeper.database.close()
    next_life = bench(tmp_path)
    async with next_life.client() as client:
        assert (await client.post("/v1/jobs", json=PARK, headers=headers)).text == first.text
        other = await client.post("/v1/jobs", json=PARK, headers=headers | {"Idempotency-Key": "k2"})
        assert (other.status_code, other.json()["code"]) == (409, "lease_lost")
    assert next_life.performer.performed == []
    next_life.keeper.database.close()


async def test_a_key_with_another_body_is_refused_and_a_fleet_without_one(open_bench):
    async with open_bench.client() as client:
        headers = await leased(client)
        missing = await client.post("/v1/jobs", json=PARK, headers=headers)
        assert (missing.status_code, missing.json()["code"]) == (400, "idempotency_key_missing")
        keyed = headers | {"Idempotency-Key": "k1"}
        assert (await client.post("/v1/jobs", json=PARK, headers=keyed)).status_code == 202
        await open_bench.settled()
        reused = await client.post("/v1/jobs", json={"kind": "look"}, headers=keyed)
        assert (reused.status_code, reused.json()["code"]) == (422, "idempotency_key_reused")
        odd = await client.post("/v1/jobs", json=PARK, headers=headers | {"Idempotency-Key": "two words"})
        assert odd.status_code == 422


async def test_two_at_once_with_one_key_are_one_job(open_bench):
    async with open_bench.client() as client:
        headers = await leased(client) | {"Idempotency-Key": "k1"}
        answers = await asyncio.gather(*(client.post("/v1/jobs", json=PARK, headers=headers) for _ in range(8)))
    told = {(answer.status_code, answer.json().get("code")) for answer in answers}
    assert told <= {(202, ""), (409, "idempotency_in_progress")}
    assert len({answer.json()["job_id"] for answer in answers if answer.status_code == 202}) == 1
    assert len(open_bench.service.engine.jobs) == 1


async def test_a_refusal_is_not_kept_under_its_key(open_bench):
    open_bench.performer.hold = asyncio.Event()
    async with open_bench.client() as client:
        headers = await leased(client)
        first = await client.post("/v1/jobs", json={"kind": "look"}, headers=headers | {"Idempotency-Key": "k1"})
        busy = await client.post("/v1/jobs", json={"kind": "look"}, headers=headers | {"Idempotency-Key": "k2"})
        assert (busy.status_code, busy.json()["code"]) == (409, "busy")
        assert busy.json()["references"]["job_id"] == first.json()["job_id"]
        assert busy.json()["references"]["owner"] == "truck 7"
        await open_bench.service.engine.stop("enough")
        open_bench.performer.hold = None
        retried = await client.post("/v1/jobs", json={"kind": "look"}, headers=headers | {"Idempotency-Key": "k2"})
        assert retried.status_code == 202


async def test_an_expired_command_starts_nothing(open_bench):
    async with open_bench.client() as client:
        headers = await leased(client) | {"Idempotency-Key": "k1"}
        now_s = (await client.get("/v1/time")).json()["t_unix_ns"] * 1e-9
        late = await client.post("/v1/jobs", json=PARK, headers=headers | {"Longreach-Expires": str(now_s - 1.0)})
        assert (late.status_code, late.json()["code"]) == (409, "expired")
        in_time = await client.post("/v1/jobs", json=PARK, headers=headers | {"Longreach-Expires": str(now_s + 60.0)})
        assert in_time.status_code == 202


async def test_cancel_is_a_state_until_the_machine_stands(open_bench):
    open_bench.performer.hold = asyncio.Event()
    async with open_bench.client() as client:
        job = (await client.post("/v1/jobs", json={"kind": "look"}, headers=open_bench.control())).json()
        await asyncio.sleep(0.05)
        cancelled = await client.post(f"/v1/jobs/{job['job_id']}/cancel")
        assert (cancelled.status_code, cancelled.json()["state"]) == (202, "stopping")
        await open_bench.settled()
        ended = (await client.get(f"/v1/jobs/{job['job_id']}")).json()
        assert (ended["state"], ended["reason"]) == ("stopped", "cancelled by local")
        again = await client.post(f"/v1/jobs/{job['job_id']}/cancel")
        assert (again.status_code, again.json()["code"]) == (409, "job_ended")
        assert (await client.post("/v1/jobs/nope/cancel")).status_code == 404


async def test_what_cannot_be_written_down_does_not_move_and_readiness_says_so(open_bench):
    async with open_bench.client() as client:
        headers = open_bench.control()
        open_bench.keeper.database.write(lambda db: db.execute("PRAGMA query_only = 1"))
        refused = await client.post("/v1/jobs", json=PARK, headers=headers)
        assert (refused.status_code, refused.json()["code"]) == (503, "store")
        assert "readonly" in refused.json()["detail"]
        assert any("cannot be written" in reason for reason in (await client.get("/readyz")).json()["reasons"])
        assert "store" in [fault["fault_id"] for fault in (await client.get("/v1/faults")).json()]
        lease = await client.post("/v1/lease/take", json={"owner": "anna", "reason": "look at it"})
        assert (lease.status_code, lease.json()["code"]) == (503, "store")
        assert (await client.post("/v1/stop")).status_code == 200
    assert open_bench.performer.performed == []
    assert all(job.state is JobState.FAILED for job in open_bench.service.engine.jobs)


async def test_a_database_that_was_removed_is_noticed_by_itself_and_refuses_motion(open_bench, monkeypatch):
    monkeypatch.setattr("server.jobs.keeper.STORE_PROBE_PERIOD_S", 0.01)
    async with open_bench.client() as client:
        held = open_bench.control()
        for file in open_bench.keeper.database.path.parent.iterdir():
            file.unlink()
        watching = asyncio.create_task(open_bench.keeper.watch())
        async with asyncio.timeout(10.0):
            while not open_bench.service.store_problem:  # noqa: ASYNC110 the keeper has no listener for it
                await asyncio.sleep(0.01)
        watching.cancel()
        ready, faults = await client.get("/readyz"), (await client.get("/v1/faults")).json()
        assert ready.status_code == 503
        assert any("was removed" in reason for reason in ready.json()["reasons"])
        assert [(fault["level"], "start it again" in fault["text"]) for fault in faults if fault["fault_id"] == "store"]
        answer = await client.post("/v1/jobs", json=PARK, headers=held)
        assert (answer.status_code, answer.json()["code"]) == (503, "store")
    assert open_bench.performer.performed == []


async def test_the_audit_tells_who_commanded_what_and_what_came_of_it(keyed):
    async with keyed.client("fleet") as fleet, keyed.client("operator") as operator:
        headers = await leased(fleet)
        await fleet.post("/v1/jobs", json=PARK, headers=headers)
        await fleet.post("/v1/jobs", json=PARK, headers=headers | {"Idempotency-Key": "k1", "X-Request-Id": "r-7"})
        await keyed.settled()
        await operator.post("/v1/lease/take", json={"owner": "anna", "reason": "in the way"})
        await operator.post("/v1/stop")
        lines = (await operator.get("/v1/audit")).json()
        assert (await fleet.get("/v1/audit")).status_code == 403
        older = (await operator.get(f"/v1/audit?limit=1&before={lines[0]['number']}")).json()
    told = [(line["who"], line["role"], line["action"], line["outcome"], line["fencing"]) for line in reversed(lines)]
    first = int(headers["Longreach-Fencing"])
    assert told == [
        ("fleet 1", "fleet", "lease.acquire", "accepted", first),
        ("fleet 1", "fleet", "job.park", "idempotency_key_missing", first),
        ("fleet 1", "fleet", "job.park", "accepted", first),
        ("operator 1", "operator", "lease.take", "accepted", first + 1),
        ("operator 1", "operator", "stop", "accepted", 0),
    ]
    assert (lines[2]["request_id"], lines[2]["idempotency_key"]) == ("r-7", "k1")
    assert [line["number"] for line in older] == [lines[1]["number"]]


@pytest.mark.parametrize("body", [{"kind": "retract", "distance_mm": True}, {"kind": "retract", "distance_mm": "300"}])
async def test_models_are_strict(open_bench, body):
    async with open_bench.client() as client:
        answer = await client.post("/v1/jobs", json=body, headers=open_bench.control())
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")


@pytest.mark.parametrize("path", ["", "/crane-3"])
async def test_the_location_of_a_job_stays_under_the_path_that_a_proxy_has_taken_off(open_bench, path):
    async with open_bench.client() as client:
        headers = await leased(client) | {"Idempotency-Key": "k1"}
        answer = await client.post("/v1/jobs", json=PARK, headers=headers)
        place = urljoin(f"http://crane.example{path}/v1/jobs", answer.headers["location"])
        assert place == f"http://crane.example{path}/v1/jobs/{answer.json()['job_id']}"
        assert (await client.get(answer.headers["location"])).status_code == 200  # joined to the server's address
        await open_bench.settled()


async def test_a_plan_expires_by_the_clock_that_execution_reads(open_bench, monkeypatch):
    now_s, keeper, plan_hash = time.time(), open_bench.keeper, "0123456789abcdef"
    view = "{}"
    keeper.database.write(lambda db: add_plan(db, plan_hash, "job", now_s, now_s + 60.0, view))
    async with open_bench.client() as client:

        async def expired():
            return (await client.get(f"/v1/plans/{plan_hash}")).json()["expired"]

        assert await expired() is True  # of an earlier life
        keeper.plan_expiries_ns[plan_hash] = mono_ns() + 60 * 10**9
        monkeypatch.setattr("time.time", lambda: now_s + 1e6)
        assert await expired() is False
        keeper.plan_expiries_ns[plan_hash] = mono_ns() - 1
        monkeypatch.setattr("time.time", lambda: 5.0)
        assert await expired() is True
