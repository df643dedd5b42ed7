"""Control over REST: routes, headers, and what happens to a job whose lease is lost."""

import asyncio

import httpx
import pytest
from fastapi import FastAPI
from test_api_routes import MACHINE, StandInLink, StandInPerformer, StandInRecorder, StandInVision

from machine.chain import chain_of
from server.access.desk import LeaseDesk
from server.api.jobs import jobs_router
from server.api.lease import lease_router
from server.api.problems import install_problem_handlers
from server.api.state import state_router
from server.jobs.cell import Cell
from server.jobs.engine import JobEngine, JobState
from server.jobs.lease_guard import guard_lease
from server.jobs.requests import Settle
from server.jobs.service import JobService
from server.settings import ServerSettings


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


class NeverEnding(StandInPerformer):
    may_be_moving = True

    async def perform(self, request):
        await asyncio.get_running_loop().create_future()


def standing():
    yield Settle()


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def service(clock):
    cell = Cell(ServerSettings(), MACHINE, chain_of(MACHINE), "", StandInLink(), StandInVision(), StandInRecorder())
    return JobService(cell, JobEngine(NeverEnding(cell.link), leases=LeaseDesk(clock=clock)))


@pytest.fixture
async def client(service):
    app = FastAPI()
    install_problem_handlers(app)
    for router in (state_router(service), jobs_router(service), lease_router(service.engine.leases)):
        app.include_router(router)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://test") as opened:
        yield opened


async def acquired(client, owner="anna", **more):
    answer = await client.post("/v1/lease", json={"owner": owner, **more})
    assert answer.status_code == 201, answer.text
    return answer.json()


def headers_of(lease):
    return {"Longreach-Lease": lease["lease_id"], "Longreach-Fencing": str(lease["fencing"])}


async def test_everybody_sees_who_has_control_and_nobody_the_secret(client):
    assert (await client.get("/v1/lease")).json()["owner"] is None
    lease = await acquired(client, ttl_s=20.0)
    shown = await client.get("/v1/lease")
    assert shown.json() | {"expires_in_s": 0} == {
        "owner": "anna",
        "kind": "operator",
        "fencing": 1,
        "expires_in_s": 0,
        "stale": False,
        "asked_by": [],
        "offered_to": "",
    }
    state = await client.get("/v1/state")
    assert state.json()["control"] == shown.json()
    assert lease["lease_id"] not in shown.text + state.text


async def test_a_second_one_is_refused_by_name(client):
    await acquired(client)
    answer = await client.post("/v1/lease", json={"owner": "fleet 1", "kind": "fleet"})
    assert (answer.status_code, answer.json()["code"]) == (409, "lease_held")
    assert answer.json()["references"]["owner"] == "anna"
    assert "ask" in answer.json()["hint"]


async def test_release_ends_it_and_its_headers_then_fire_nothing(client, service):
    lease = await acquired(client)
    assert (await client.delete(f"/v1/lease/{lease['lease_id']}")).status_code == 204
    answer = await client.post("/v1/jobs", json={"kind": "look"}, headers=headers_of(lease))
    assert (answer.status_code, answer.json()["code"]) == (409, "lease_lost")
    assert not service.engine.jobs


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/disarm", "/v1/reset"])
async def test_commands_without_control_are_refused_and_stop_never_is(client, service, path):
    body = {"kind": "look"} if path == "/v1/jobs" else None
    answer = await client.post(path, json=body)
    assert (answer.status_code, answer.json()["code"]) == (403, "no_lease")
    assert (await client.post(path, json=body, headers={"Longreach-Fencing": "many"})).status_code == 422
    assert (await client.post("/v1/stop")).status_code == 200
    assert service.cell.link.stops


async def test_a_fleet_takes_from_nobody_a_person_from_everybody(client):
    await acquired(client, "fleet 1", kind="fleet")
    refused = await client.post("/v1/lease/take", json={"owner": "fleet 2", "kind": "fleet", "reason": "hurry"})
    assert (refused.status_code, refused.json()["code"]) == (403, "take_refused")
    taken = await client.post("/v1/lease/take", json={"owner": "anna", "reason": "a person is in the way"})
    assert (taken.status_code, taken.json()["fencing"]) == (201, 2)


async def test_hand_over_by_asking_and_granting(client):
    lease = await acquired(client)
    assert (await client.post("/v1/lease/ask", json={"owner": "bert"})).json()["asked_by"] == ["bert"]
    granted = await client.post(f"/v1/lease/{lease['lease_id']}/grant", json={"to": "bert"})
    assert granted.json()["offered_to"] == "bert"
    assert (await acquired(client, "bert"))["fencing"] == 2


async def test_keep_alive_revives_and_a_stale_one_starts_nothing(client, clock, service):
    lease = await acquired(client, ttl_s=5.0)
    clock.now_s += 6.0
    answer = await client.post("/v1/jobs", json={"kind": "look"}, headers=headers_of(lease))
    assert (answer.status_code, answer.json()["code"]) == (409, "lease_stale")
    assert not service.engine.jobs
    assert (await client.put(f"/v1/lease/{lease['lease_id']}")).json()["fencing"] == 1
    started = await client.post("/v1/jobs", json={"kind": "look"}, headers=headers_of(lease))
    assert (started.status_code, started.json()["owner"]) == (202, "anna")


async def test_the_guard_ends_also_when_control_changes_in_the_same_moment(client, service):
    guard = asyncio.create_task(guard_lease(service.engine))
    await asyncio.sleep(0.01)
    service.engine.leases.acquire("anna")
    guard.cancel()
    done, _ = await asyncio.wait({guard}, timeout=2.0)
    assert done


@pytest.mark.parametrize("how", ["taken", "stale", "released", "handed over"])
async def test_the_job_of_a_lost_lease_is_stopped_and_says_why(client, clock, service, how):
    desk = service.engine.leases
    lease = desk.acquire("fleet 1")
    job = service.engine.submit("park", standing(), "fleet 1", lease)
    ended = asyncio.Event()
    service.engine.on_event(lambda _job, event: ended.set() if event.name == "ended" else None)
    guard = asyncio.create_task(guard_lease(service.engine))
    await asyncio.sleep(0.05)
    assert job.state is JobState.RUNNING
    if how == "taken":
        await client.post("/v1/lease/take", json={"owner": "anna", "reason": "somebody is in the way"})
    elif how == "stale":
        clock.now_s += 60.0
    elif how == "released":
        desk.release(lease.lease_id)
    else:
        desk.offer_to(lease.lease_id, "bert")
        await acquired(client, "bert")
    await asyncio.wait_for(ended.wait(), 5.0)
    guard.cancel()
    words = {"taken": "anna took it", "stale": "went stale", "released": "released it", "handed over": "bert acquired"}
    assert job.state is JobState.STOPPED
    assert words[how] in job.reason
    assert any("control" in reason for reason in service.cell.link.stops)
