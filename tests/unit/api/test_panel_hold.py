"""Hold-to-run's shell with a stand-in socket and machine: who may press, what keeps it going, what ends it."""

import asyncio
import contextlib
import hashlib
import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from fastapi import WebSocketDisconnect
from test_api_routes import MACHINE, StandInLink, StandInPerformer, StandInRecorder, StandInVision, looked, previewed

from machine.chain import chain_of
from server.access.lease import LeaseKind
from server.access.roles import HUMAN_ROLES, Caller
from server.api import hold as module
from server.api.hold import hold_router
from server.api.hold_rule import HoldRequiredError, mode_of, require_hold, why_not_commissioned
from server.api.panel_memory import PanelMemory
from server.commissioning.check_list import CHECK_LIST_STEPS
from server.commissioning.contracts import StepResult, Verdict
from server.commissioning.report import Report, to_json
from server.errors import SettingsError
from server.jobs.cell import Cell
from server.jobs.engine import JobEngine
from server.jobs.hold import reply_to
from server.jobs.request_bodies import ExecuteRequest, JogRequest, LookRequest, ParkRequest, PreviewRequest
from server.jobs.requests import MachineReading
from server.jobs.service import JobService
from server.settings import RecordingSettings, ServerSettings

HERE = Caller()
CHAIN = chain_of(MACHINE)
MIDDLE = 0.5 * (CHAIN.q_min + CHAIN.q_max)


class Vision(StandInVision):
    stream_text = ""
    restarts = 0

    def on_report(self, listener):
        pass


class Moving(StandInPerformer):
    """Reads the machine, then moves for ever: until it is stopped."""

    def __init__(self, link):
        super().__init__(link)
        self.moving = asyncio.Event()

    async def perform(self, request):
        if type(request).__name__ in ("ReadMachine", "Settle"):
            return MachineReading(MIDDLE, MIDDLE, 0, 0)
        self.may_be_moving = True
        self.moving.set()
        await asyncio.Event().wait()


class Socket:
    """The page's end: what it says goes in, what it hears comes out."""

    client = None

    class state:  # noqa: N801 # as starlette's
        pass

    def __init__(self):
        self.headers = {"host": "here", "origin": "http://here"}
        self._in, self.out, self.closed = asyncio.Queue(), asyncio.Queue(), asyncio.Event()

    async def accept(self):
        pass

    async def close(self, code=1000, reason=""):
        self.closed.set()

    async def send_text(self, text):
        self.out.put_nowait(json.loads(text))

    async def receive_text(self):
        said = await self._in.get()
        if said is None:
            raise WebSocketDisconnect(1006)
        return said

    def say(self, **message):
        self._in.put_nowait(json.dumps(message))

    def vanish(self):
        self._in.put_nowait(None)

    async def hear(self, key):
        while key not in (told := await asyncio.wait_for(self.out.get(), 60.0)):
            pass
        return told


class Clock:
    """Five milliseconds pass with every look at it: a busy computer changes nothing."""

    def __init__(self):
        self.ns = 0

    def mono_ns(self):
        self.ns += 5_000_000
        return self.ns

    def time(self):
        return self.ns * 1e-9


@pytest.fixture
def clock(monkeypatch):
    ticking = Clock()
    monkeypatch.setattr(module, "time", ticking)
    monkeypatch.setattr(module, "mono_ns", ticking.mono_ns)
    return ticking


@pytest.fixture
async def service(tmp_path, clock):
    settings = ServerSettings(recording=RecordingSettings(folder=str(tmp_path)))
    cell = Cell(settings, MACHINE, chain_of(MACHINE), "", StandInLink(), Vision(), StandInRecorder())
    engine = JobEngine(Moving(cell.link))
    yield JobService(cell, engine)
    await engine.close()


@pytest.fixture
async def pressed(service):
    """A socket that has pressed Park and is held, its memory and the task that serves it."""
    socket, memory = Socket(), PanelMemory(service)
    lease = service.engine.leases.acquire("anna", ttl_s=60.0)
    (route,) = hold_router(service, memory).routes
    serving = asyncio.create_task(route.endpoint(socket))
    socket.say(press={"kind": "park", "wall_free": True}, lease_id=lease.lease_id, fencing=lease.fencing)
    yield socket, memory, serving
    serving.cancel()


async def test_answered_challenges_keep_it_going_and_the_release_stops_it(service, pressed):
    socket, memory, serving = pressed
    bond = (await socket.hear("held"))["bond"]
    assert memory.held_by == "anna"
    for _ in range(3):
        asked = (await socket.hear("challenge"))["challenge"]
        socket.say(seq=asked["seq"], reply=reply_to(asked["nonce"]), bond=bond)
    socket.say(release="button up")
    told = await socket.hear("ended")
    assert told["ended"] == "stopped"
    assert "button up" in told["reason"]
    assert service.cell.link.stops
    await serving
    assert memory.held_by == ""
    *proofs, freed = service.cell.link.held_until  # what the link process would have stopped by, and then nothing
    assert freed is None
    assert len(proofs) >= 3
    assert proofs == sorted(proofs)


async def test_a_socket_that_is_gone_is_a_button_let_go(service, pressed):
    socket, _, serving = pressed
    await socket.hear("held")
    socket.vanish()
    await serving
    assert service.engine.current.state.value == "stopped"
    assert "socket closed" in service.engine.current.reason


async def test_a_socket_that_breaks_at_the_first_word_leaves_nothing_moving(service):
    class Broken(Socket):
        async def send_text(self, text):
            raise RuntimeError("the socket is closed")

    socket, memory = Broken(), PanelMemory(service)
    lease = service.engine.leases.acquire("anna", ttl_s=60.0)
    (route,) = hold_router(service, memory).routes
    socket.say(press={"kind": "park", "wall_free": True}, lease_id=lease.lease_id, fencing=lease.fencing)
    await route.endpoint(socket)
    assert service.engine.current.state.value == "stopped"


async def test_nonsense_is_a_button_let_go(service, pressed):
    socket, _, serving = pressed
    await socket.hear("held")
    socket.say(anything=1)
    await serving
    assert service.engine.current.state.value == "stopped"


async def test_silence_stops_it_and_leaves_an_alarm(service, pressed, clock):
    socket, memory, serving = pressed
    await socket.hear("challenge")
    clock.ns += 260_000_000
    await serving
    assert "silent" in service.engine.current.reason
    assert [alarm.code for alarm in memory.alarm_book.alarms] == ["hold_lost"]


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"lease_id": "no-lease-of-anybody"}, "lease_lost"),
        ({"fencing": 99}, "lease_lost"),
        ({"press": {"kind": "execute", "plan_hash": "f" * 16}}, "plan_refused"),
        ({"press": {"kind": "dance"}}, "invalid_request"),
    ],
)
async def test_what_may_not_be_pressed_moves_nothing(service, change, code):
    socket, memory = Socket(), PanelMemory(service)
    service.cell.knowledge.last_look, service.cell.knowledge.previewed_plan = looked(), previewed(60.0)
    lease = service.engine.leases.acquire("anna", ttl_s=60.0)
    (route,) = hold_router(service, memory).routes
    press = {
        "press": {"kind": "park", "wall_free": True},
        "lease_id": lease.lease_id,
        "fencing": lease.fencing,
    } | change
    socket.say(**press)
    await route.endpoint(socket)
    assert (await socket.hear("refused"))["code"] == code
    assert service.engine.current is None


def test_on_a_real_machine_an_operators_click_moves_nothing(service):
    operator = service.engine.leases.acquire("anna", LeaseKind.OPERATOR, 60.0)
    for still in (LookRequest(kind="look"), PreviewRequest(kind="preview")):
        require_hold("REAL", still, operator, HERE)
    require_hold("SIM", ParkRequest(kind="park"), operator, HERE)
    for moving in (ParkRequest(kind="park"), ExecuteRequest(kind="execute", plan_hash="0" * 16)):
        with pytest.raises(HoldRequiredError):
            require_hold("REAL", moving, operator, HERE)


@pytest.mark.parametrize(
    ("caller", "kind", "held"),
    [
        (HERE, LeaseKind.FLEET, False),  # without keys the lease alone says what it is
        (HERE, LeaseKind.ENGINEER, True),
        (Caller("truck 7", "fleet", by_key=True), LeaseKind.FLEET, False),
        (Caller("truck 7", "fleet", by_key=True), LeaseKind.OPERATOR, True),
        *((Caller("anna", role, by_key=True), kind, True) for role in HUMAN_ROLES for kind in LeaseKind),
    ],
)
def test_a_person_holds_on_a_real_machine_whatever_the_lease_is_called(service, caller, kind, held):
    lease = service.engine.leases.acquire("anna", kind, 60.0)
    with pytest.raises(HoldRequiredError) if held else contextlib.nullcontext():
        require_hold("REAL", ParkRequest(kind="park"), lease, caller)


def test_a_forgotten_line_in_the_settings_does_not_make_steel_move_by_a_click():
    real, simulated = SimpleNamespace(simulation=False), SimpleNamespace(simulation=True)
    assert mode_of("SIM", None) == mode_of("SIM", simulated) == "SIM"
    assert {mode_of("SIM", real), mode_of("REAL", real), mode_of("REAL", simulated), mode_of("REAL", None)} == {"REAL"}


async def test_the_page_is_told_to_hold_when_the_plc_drives_no_simulation(service):
    memory = PanelMemory(service)
    assert not memory._hold_state().required
    service.cell.link.latest = SimpleNamespace(simulation=False)
    assert memory._hold_state().required


JOG = {"kind": "jog", "axis": "joint_2", "direction": 1}


@pytest.mark.parametrize("ending", ["button up", "window lost focus", "page left", "closed tab", "dead network"])
async def test_a_jog_ends_as_every_hold_does(service, clock, ending):
    """A hundred presses each, held for 0 to 2 answers."""
    memory = PanelMemory(service)
    lease = service.engine.leases.acquire("anna", ttl_s=3600.0)
    (route,) = hold_router(service, memory).routes
    for number in range(100):
        socket = Socket()
        serving = asyncio.create_task(route.endpoint(socket))
        socket.say(press=JOG, lease_id=lease.lease_id, fencing=lease.fencing)
        bond = (await socket.hear("held"))["bond"]
        for _ in range(number % 3):
            asked = (await socket.hear("challenge"))["challenge"]
            socket.say(seq=asked["seq"], reply=reply_to(asked["nonce"]), bond=bond)
        if ending == "closed tab":
            socket.vanish()
        elif ending == "dead network":  # it says nothing more, and time passes
            clock.ns += 260_000_000
        else:
            socket.say(release=ending)
        await serving
        job = service.engine.current
        assert (job.kind, job.state.value) == ("jog", "stopped")
        assert {"closed tab": "socket closed", "dead network": "silent"}.get(ending, ending) in job.reason
        assert len(service.cell.link.stops) >= number + 1
    assert service.cell.link.held_until[-1] is None


@pytest.mark.parametrize("mode", ["SIM", "REAL"])
@pytest.mark.parametrize("kind", LeaseKind)
def test_a_jog_is_never_a_click_not_even_of_a_program_in_a_simulation(service, mode, kind):
    lease = service.engine.leases.acquire("anna", kind, 60.0)
    with pytest.raises(HoldRequiredError, match="held"):
        require_hold(mode, JogRequest(**JOG), lease, Caller("truck 7", "fleet", by_key=True))


async def test_a_real_machine_jogs_only_after_its_commissioning(service):
    service.cell.link.latest = SimpleNamespace(simulation=False)
    lease = service.engine.leases.acquire("anna", ttl_s=60.0)
    (route,) = hold_router(service, PanelMemory(service)).routes
    pressed = {"press": JOG, "lease_id": lease.lease_id, "fencing": lease.fencing}
    socket = Socket()
    socket.say(**pressed)
    await route.endpoint(socket)
    assert (await socket.hear("refused"))["code"] == "not_commissioned"
    assert service.engine.current is None
    service.cell.not_commissioned = ""
    socket = Socket()
    serving = asyncio.create_task(route.endpoint(socket))
    socket.say(**pressed)
    await socket.hear("held")
    socket.vanish()
    await serving
    assert service.engine.current.kind == "jog"


def a_report(**changed):
    results = tuple(StepResult(step.name, Verdict.PASS, "", duration_s=1.0) for step in CHECK_LIST_STEPS)
    digest = hashlib.sha256(b"the machine file").hexdigest()
    report = Report("crane", "2026-11-29T10:00:00+00:00", "1", "link", 1, digest, False, results, (), {}, complete=True)
    return replace(report, **changed)


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({}, ""),
        ({"simulation": True}, "simulated"),
        ({"machine_sha256": "0" * 64}, "another machine file"),
        ({"complete": False}, "interrupted"),
        ({"results": ()}, "8 of 8 steps have not passed"),
        ({"results": (StepResult(CHECK_LIST_STEPS[0].name, Verdict.FAIL, "no"),)}, "link dry run"),
    ],
)
def test_a_commissioning_counts_when_all_of_it_passed_on_this_machine(tmp_path, changed, why):
    file = tmp_path / "report.json"
    file.write_text(to_json(a_report(**changed)), encoding="utf-8")
    found = why_not_commissioned(str(file), "the machine file")
    assert (why in found) if why else found == ""


def test_without_a_report_a_machine_is_not_commissioned_and_a_bad_file_is_refused(tmp_path):
    assert "not set" in why_not_commissioned(None, "")
    with pytest.raises(SettingsError, match="commissioning_report"):
        why_not_commissioned(str(tmp_path / "none.json"), "")
    (tmp_path / "other.json").write_text("{}", encoding="utf-8")
    with pytest.raises(SettingsError, match="not a report"):
        why_not_commissioned(str(tmp_path / "other.json"), "")
