"""The REST side with a stand-in cell: what it answers to good, bad and impossible requests. No process is started."""

import asyncio
import json
from types import SimpleNamespace

import httpx
import numpy as np
import pytest
from fastapi import FastAPI

from machine.chain import chain_of
from recording.clock import mono_ns
from server.api.jobs import jobs_router
from server.api.problems import install_problem_handlers
from server.api.state import STATE_CACHE_TTL_S, camera_reason, state_router
from server.camera.client import STARTING_STATUS_TEXT
from server.camera.contracts import MarksFound
from server.jobs.cell import Cell
from server.jobs.engine import JobEngine
from server.jobs.knowledge import LookTaken, PreviewedPlan
from server.jobs.records import ErrorMm, LookRecord
from server.jobs.requests import MachineReading
from server.jobs.service import JobService
from server.link.contracts import LinkHealth, LinkPhase
from server.motion.contracts import PathPlan, PlanStatus
from server.settings import ServerSettings, read_machine
from server.targets.contracts import PatchStatus, refused_patch

MACHINE = read_machine("hiab033")
ERROR = ErrorMm(1, 2, 300, 4, 0.7, 0.7, 0.7, 0.2, 300, 0, 0, 400)


class StandInLink:
    def __init__(self):
        self.health = LinkHealth(LinkPhase.LINKED, 1.0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 0)
        self.latest = None
        self.stops = []

    async def stop(self, reason):
        self.stops.append(reason)

    async def hold_until(self, t_mono_ns):
        self.held_until = [*getattr(self, "held_until", []), t_mono_ns]


class StandInVision:
    latest = None
    stream_text = ""
    latest_preview = None

    def on_report(self, callback):
        self.told = callback

    def reports_since(self, t_mono_ns):
        return []

    async def find_marks(self, image, diameters_m):
        return MarksFound(1, (), "this stand-in sees nothing")

    async def teach_view(self, image, box):
        return "this stand-in sees nothing"

    async def measure_target(self, image, pixel, roll_rad):
        return refused_patch(PatchStatus.NO_TEXTURE, "this stand-in sees nothing", pixel)


class StandInRecorder:
    def __getattr__(self, name):
        return lambda *args, **kwargs: None


class StandInPerformer:
    may_be_moving = False

    def __init__(self, link):
        self._link = link

    async def perform(self, request):
        raise AssertionError(f"{request} should not have been reached")

    async def stop_motion(self, reason):
        await self._link.stop(reason)

    def release(self):
        pass

    async def hold_until(self, t_mono_ns):
        await self._link.hold_until(t_mono_ns)


def control(service):
    """Headers of one who has control."""
    lease = service.engine.leases.acquire("test", ttl_s=60.0)
    return {"Longreach-Lease": lease.lease_id, "Longreach-Fencing": str(lease.fencing)}


@pytest.fixture
def service():
    cell = Cell(ServerSettings(), MACHINE, chain_of(MACHINE), "", StandInLink(), StandInVision(), StandInRecorder())
    return JobService(cell, JobEngine(StandInPerformer(cell.link)))


@pytest.fixture
async def client(service):
    app = FastAPI()
    install_problem_handlers(app)
    for router in (state_router, jobs_router):
        app.include_router(router(service))
    transport, headers = httpx.ASGITransport(app), control(service)
    async with httpx.AsyncClient(transport=transport, base_url="http://test", headers=headers) as opened:
        yield opened


def looked(age_s=0.0):
    t_ns = mono_ns() - int(age_s * 1e9)
    reading = MachineReading(np.zeros(6), np.zeros(6), t_ns, t_ns)
    return LookTaken(None, reading, ERROR, LookRecord("ok", "", ERROR, 20, 0.1, t_ns, t_ns), None)


def previewed(expires_in_s):
    plan = PathPlan(
        PlanStatus.OK, "", None, np.eye(4)[None], np.zeros(6), 0.3, 5.0, 0.1, float("inf"), 0.4, np.zeros(6)
    )
    now = mono_ns()
    expires = now + int(expires_in_s * 1e9)
    q = np.zeros(6)
    return PreviewedPlan(plan, "0123456789abcdef", q, q, q, np.eye(4), ERROR, (1, 1, 1), "", now, expires)


async def test_the_state_is_json_even_when_nothing_is_there(client):
    state = await client.get("/v1/state")
    assert state.status_code == 200
    body = json.loads(state.text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert body["camera"]["warnings"] == ["no image yet"]
    assert body["link"]["age_ms"] is None
    assert body["steps"]["preview"] == "look first"


async def test_nobody_parks_before_having_looked_for_a_wall(client, service):
    """After a restart at the stand-off the wall is there, but not known: folding would turn into it."""
    assert (await client.get("/v1/state")).json()["steps"]["park"] == "look first"
    refused = await client.post("/v1/jobs", json={"kind": "park"})
    assert (refused.status_code, refused.json()["code"]) == (409, "no_wall")
    assert "look first, or park with wall_free = true" in refused.json()["detail"]
    assert not service.engine.jobs
    told = await client.post("/v1/jobs", json={"kind": "park", "wall_free": True})
    assert told.status_code == 202
    await asyncio.wait({service.engine._task}, timeout=5.0)
    service.cell.knowledge.T_base_ooi = np.eye(4)  # a look
    await asyncio.sleep(2.0 * STATE_CACHE_TTL_S)
    assert (await client.get("/v1/state")).json()["steps"]["park"] == ""
    assert (await client.post("/v1/jobs", json={"kind": "park"})).status_code == 202
    await asyncio.wait({service.engine._task}, timeout=5.0)


async def test_an_unknown_wall_and_a_plan_are_json(client, service):
    service.cell.knowledge.previewed_plan = previewed(60.0)
    plan = (await client.get("/v1/state")).json()["plan"]
    assert plan["clearance_mm"] is None
    assert plan["plan_hash"] == "0123456789abcdef"


async def test_readiness_names_its_reasons(client, service):
    service.cell.link.health = LinkHealth(LinkPhase.OFFLINE, 9e9, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 0)
    answer = await client.get("/readyz")
    assert answer.status_code == 503
    assert "PLC does not answer" in answer.json()["reasons"][0]
    assert "camera delivers no images" in answer.json()["reasons"][1]


@pytest.mark.parametrize(
    ("phase", "held"), [("disarmed", True), ("offline", True), ("linked", False), ("armed", False)]
)
async def test_a_pc_whose_plc_another_one_holds_is_not_ready(client, service, phase, held):
    """States of the PLC arrive all the same. The one that holds the session only warns."""
    other = "another PC holds the PLC's session 0x6f646f25; end the server there"
    link = LinkHealth(LinkPhase(phase), 1.0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 0, other_pc=other)
    service.cell.link.health = link
    assert (other in (await client.get("/readyz")).json()["reasons"]) is held
    assert ((await client.get("/v1/state")).json()["steps"]["retract"] == other) is held


async def test_no_job_begins_while_the_numerics_load(client, service):
    service.cell.startup_note = "the server is starting: it loads its numerics"
    assert service.cell.startup_note in (await client.get("/readyz")).json()["reasons"]
    refused = await client.post("/v1/jobs", json={"kind": "look"})
    assert (refused.status_code, refused.json()["code"]) == (409, "starting")
    assert not service.engine.jobs
    service.cell.startup_note = ""
    assert (await client.post("/v1/jobs", json={"kind": "look"})).status_code == 202
    await asyncio.wait({service.engine._task}, timeout=5.0)


def test_a_camera_process_that_starts_is_no_loose_cable():
    assert camera_reason(None, STARTING_STATUS_TEXT) == STARTING_STATUS_TEXT
    assert "cable" in (camera_reason(None, "stream: not found") or "")


def test_an_old_picture_is_told_with_its_age():
    assert camera_reason(999.0) is None
    assert camera_reason(2300.0) == (
        "the camera's newest image is 2.3 s old (limit 1.0 s): check its cable, its rate and how busy its computer is"
    )


@pytest.mark.parametrize(
    "body",
    [
        {"kind": "fly"},
        {"kind": "execute"},
        {"kind": "execute", "plan_hash": "../../etc/passwd"},
        {"kind": "retract", "distance_mm": 5000.0},
        {"kind": "retract", "distance_mm": "NaN"},
        {"kind": "look", "owner": ""},
        {"kind": "look", "surprise": 1},
        {},
        [],
        None,
    ],
)
async def test_malformed_requests_are_problems_and_start_nothing(client, service, body):
    answer = await client.post("/v1/jobs", json=body)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["code"] == "invalid_request"
    assert not service.engine.jobs


async def test_a_number_beyond_its_limit_is_told_with_both(client):
    detail = (await client.post("/v1/jobs", json={"kind": "retract", "distance_mm": 5000.0})).json()["detail"]
    assert "distance_mm" in detail
    assert "less than or equal to" in detail
    assert detail.endswith("(sent: 5000)")
    text = (await client.post("/v1/jobs", json={"kind": "retract", "distance_mm": "<b>"})).json()["detail"]
    assert "<b>" not in text


async def test_bytes_that_are_no_json_are_refused(client):
    answer = await client.post("/v1/jobs", content=b"\xff\xfe{", headers={"content-type": "application/json"})
    assert answer.status_code == 400
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("kind", ["orient", "calibrate", "preview"])
async def test_no_motion_on_a_look_that_a_joint_has_left(client, service, kind):
    service.cell.knowledge.last_look = looked()
    service.cell.link.latest = SimpleNamespace(q_rad=np.deg2rad([0.0, 0.0, -0.2, 0.0, 0.0, 0.0]), simulation=True)
    answer = await client.post("/v1/jobs", json={"kind": kind})
    assert (answer.status_code, answer.json()["code"]) == (409, "stale_look")
    assert "joint tilt moved by -0.200 deg since the look (limit 0.115 deg); look again" in answer.json()["detail"]


@pytest.mark.parametrize("kind", ["orient", "calibrate", "preview"])
async def test_no_motion_without_a_look_or_on_a_stale_one(client, service, kind):
    assert "look first" in (await client.post("/v1/jobs", json={"kind": kind})).json()["detail"]
    service.cell.knowledge.last_look = looked(age_s=120.0)
    answer = await client.post("/v1/jobs", json={"kind": kind})
    assert answer.status_code == 409
    assert answer.json()["code"] == "stale_look"
    assert not service.engine.jobs


async def test_a_stale_or_foreign_plan_is_not_executed(client, service):
    execute = {"kind": "execute", "plan_hash": "0123456789abcdef"}
    assert "preview first" in (await client.post("/v1/jobs", json=execute)).json()["detail"]
    service.cell.knowledge.previewed_plan = previewed(60.0)
    other = await client.post("/v1/jobs", json={"kind": "execute", "plan_hash": "f" * 16})
    assert "is not the previewed one" in other.json()["detail"]
    service.cell.knowledge.previewed_plan = previewed(-1.0)
    assert "has expired" in (await client.post("/v1/jobs", json=execute)).json()["detail"]
    assert not service.engine.jobs


async def test_unknown_jobs_are_404_and_stop_always_answers(client, service):
    assert (await client.get("/v1/jobs/nope")).status_code == 404
    assert (await client.get("/v1/jobs/nope/events")).status_code == 404
    assert (await client.post("/v1/stop")).status_code == 200
    assert service.cell.link.stops == ["stopped over REST"]
