"""A PC that was suspended: ages count the time that it slept, and nothing of before is acted upon after it."""

import asyncio
import multiprocessing
import os
import time
from types import SimpleNamespace

import numpy as np
import pytest
from served import bench
from test_api_routes import MACHINE, looked, previewed

from protocol.limits import limits_of
from recording import clock
from recording.clock import SUSPENDED_REASON, SuspendWatch, mono_ns, suspended_ns
from server.camera.contracts import StreamNotice
from server.camera.process import VisionLoop
from server.link.contracts import ArmRequest
from server.link.errors import LinkError
from server.link.process import LinkProcess
from server.link.settings import LinkSettings

NIGHT_NS = 14 * 3600 * 10**9


class Sleeper:
    """Linux's clocks on a computer that sleeps when told: CLOCK_BOOTTIME goes on, CLOCK_MONOTONIC does not."""

    def __init__(self) -> None:
        self.slept_ns = 0

    def monotonic_ns(self) -> int:
        return time.monotonic_ns()

    def clock_gettime_ns(self, number: int) -> int:
        return time.clock_gettime_ns(number) + (self.slept_ns if number == time.CLOCK_BOOTTIME else 0)


@pytest.fixture
def sleeper(monkeypatch):
    made = Sleeper()
    monkeypatch.setattr(clock, "time", made)
    return made


def test_the_clock_counts_the_night_and_a_resume_is_reported_once(sleeper):
    before_ns, slept_before_ns, watch = mono_ns(), suspended_ns(), SuspendWatch()
    assert not any(watch.was_suspended() for _ in range(1000))
    sleeper.slept_ns += NIGHT_NS
    assert mono_ns() - before_ns >= NIGHT_NS
    assert suspended_ns() - slept_before_ns == pytest.approx(NIGHT_NS, abs=1e6)
    assert [watch.was_suspended() for _ in range(3)] == [True, False, False]
    sleeper.slept_ns += 5 * 10**6
    assert [watch.was_suspended() for _ in range(2)] == [True, False]


def test_a_process_that_is_held_up_between_two_readings_was_not_suspended(monkeypatch, sleeper):
    held_up = iter(np.random.default_rng(1).exponential(1e9, 10_000).cumsum().astype(int).tolist())  # between any two
    monkeypatch.setattr(sleeper, "monotonic_ns", lambda: next(held_up))
    monkeypatch.setattr(sleeper, "clock_gettime_ns", lambda _number: next(held_up))
    watch = SuspendWatch()
    assert not any(watch.was_suspended() for _ in range(1000))


@pytest.mark.parametrize("body", [{"kind": "execute", "plan_hash": "0123456789abcdef"}, {"kind": "preview"}])
async def test_what_was_seen_planned_and_granted_before_is_not_acted_upon(tmp_path, sleeper, body):
    made = bench(tmp_path)
    async with made.client(**made.control()) as client:
        made.service.cell.knowledge.last_look, made.service.cell.knowledge.previewed_plan = looked(), previewed(3600.0)
        sleeper.slept_ns += 5 * 10**9  # shorter than a look, a plan or a lease lasts
        refused = await client.post("/v1/jobs", json=body)
        assert refused.status_code == 409
        assert refused.json()["code"] in ("plan_refused", "no_look")
        lost = await client.post("/v1/jobs", json={"kind": "look"})
        assert (lost.status_code, lost.json()["code"]) == (409, "lease_lost")
        assert SUSPENDED_REASON in lost.json()["detail"]
    assert made.performer.performed == []
    made.keeper.database.close()


async def test_a_night_makes_look_plan_and_lease_old_without_anybody_watching(tmp_path, monkeypatch, sleeper):
    monkeypatch.setattr(SuspendWatch, "was_suspended", lambda _self: False)
    made = bench(tmp_path)
    held = made.control()
    made.service.cell.knowledge.last_look, made.service.cell.knowledge.previewed_plan = looked(), previewed(60.0)
    sleeper.slept_ns += NIGHT_NS
    async with made.client(**held) as client:
        refused = await client.post("/v1/jobs", json={"kind": "look"})
        assert refused.json()["code"] == "lease_stale"
    async with made.client(**made.control("another")) as client:
        assert (
            "has expired"
            in (await client.post("/v1/jobs", json={"kind": "execute", "plan_hash": "0123456789abcdef"})).json()[
                "detail"
            ]
        )
        assert (await client.post("/v1/jobs", json={"kind": "preview"})).json()["code"] == "stale_look"
    made.keeper.database.close()


async def test_the_running_job_is_stopped(tmp_path, sleeper):
    made = bench(tmp_path)
    made.performer.hold = asyncio.Event()
    async with made.client(**made.control()) as client, asyncio.timeout(20.0):
        assert (await client.post("/v1/jobs", json={"kind": "look"})).status_code == 202
        job = made.service.engine.current
        watching = asyncio.create_task(made.service.watch_suspend())
        sleeper.slept_ns += NIGHT_NS
        await asyncio.wait({made.service.engine._task})
        watching.cancel()
    assert (job.state.value, job.reason) == ("stopped", SUSPENDED_REASON)
    made.keeper.database.close()


@pytest.mark.parametrize("slept_ns", [0, NIGHT_NS])
async def test_a_plc_that_is_silent_after_a_night_is_no_failure_of_its_own(tmp_path, sleeper, slept_ns):
    """The link may lose the PLC before anything else has noticed the resume."""
    made = bench(tmp_path)
    waiting = asyncio.Event()

    async def lost(_request):
        await waiting.wait()
        raise LinkError("no state from PLC")

    made.performer.perform = lost
    async with made.client(**made.control()) as client, asyncio.timeout(20.0):
        assert (await client.post("/v1/jobs", json={"kind": "look"})).status_code == 202
        job = made.service.engine.current
        sleeper.slept_ns += slept_ns
        waiting.set()
        await asyncio.wait({made.service.engine._task})
    expected = ("stopped", SUSPENDED_REASON) if slept_ns else ("failed", "no state from PLC")
    assert (job.state.value, job.reason) == expected
    made.keeper.database.close()


def test_the_link_process_ends_and_carries_nothing_out_that_was_asked_before(sleeper):
    server, pipe = multiprocessing.Pipe()
    settings = LinkSettings(local_host="127.0.0.1", local_port=0)
    process = LinkProcess(pipe, settings, limits_of(MACHINE.joints), os.getppid())
    server.send(ArmRequest())
    sleeper.slept_ns += NIGHT_NS
    process.run()  # ends by itself
    assert process._leaving == SUSPENDED_REASON
    assert process._asked is None
    assert pipe.poll(), "the request is left in the pipe"


def test_the_vision_process_ends_and_reports_no_pair_that_was_buffered(sleeper):
    server, pipe = multiprocessing.Pipe()
    pair = np.zeros((1, 1))
    source = SimpleNamespace(read=lambda _timeout_s: pair, ended=False, state="", skipped=0)
    vision = VisionLoop(pipe, source, SimpleNamespace(process=lambda *_: pytest.fail("an old pair was worked on")))
    sleeper.slept_ns += NIGHT_NS
    vision.run()
    notice = server.recv()
    assert isinstance(notice, StreamNotice)
    assert notice.text == SUSPENDED_REASON
    assert not server.poll()
