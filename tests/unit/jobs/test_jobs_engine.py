"""The engine: one job at a time, stop on every ending, reasons kept; a stand-in performs the requests."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from server.errors import BusyError, JobFailedError
from server.jobs.engine import JobEngine, JobState
from server.jobs.requests import Arm, Move, Progress, Settle
from server.link.errors import LinkError


class StandIn:
    """Performs requests by a script: an exception is raised, `forever` waits until it is cancelled."""

    def __init__(self, script=None):
        self.script = script or {}
        self.performed, self.stops = [], []
        self.may_be_moving = False
        self.released = 0

    async def perform(self, request):
        self.performed.append(type(request).__name__)
        answer = self.script.get(type(request))
        if isinstance(request, Move):
            self.may_be_moving = True
        if answer == "forever":
            await asyncio.get_running_loop().create_future()
        if isinstance(answer, Exception):
            raise answer
        return answer

    def record(self, request):
        self.performed.append("Record")

    async def stop_motion(self, reason):
        self.stops.append(reason)
        self.may_be_moving = False

    def release(self):
        self.released += 1


def plan(*requests, result="done"):
    yield from requests
    return result


MOVE = Move(trajectory=None, purpose="test")


async def finish(engine):
    await asyncio.wait({engine._task})
    return engine.current


async def test_a_plan_runs_to_its_result_and_tells_its_story():
    stand_in = StandIn()
    engine = JobEngine(stand_in)
    heard = []
    engine.on_event(lambda job, event: heard.append(event.name))
    job = engine.submit("look", plan(Arm(), Progress("p", 1, 2, "mm", "half"), Settle()), "me")
    await finish(engine)
    assert (job.state, job.result, job.reason) == (JobState.DONE, "done", "")
    assert stand_in.performed == ["Arm", "Settle"]
    assert heard == ["started", "p", "ended"]
    assert [event.number for event in job.events] == [1, 2, 3]
    assert stand_in.stops == []


async def test_a_second_job_is_refused_and_names_the_first():
    engine = JobEngine(StandIn({Settle: "forever"}))
    first = engine.submit("position", plan(Settle()), "operator")
    await asyncio.sleep(0.05)
    with pytest.raises(BusyError, match=rf"{first.job_id} \(position\) of operator"):
        engine.submit("look", plan(Settle()), "fleet")
    await engine.stop("enough")
    assert first.state is JobState.STOPPED


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (JobFailedError("too far", "plan_out_of_reach"), "plan_out_of_reach"),
        (LinkError("silent"), "link"),
        (ValueError("bug"), "internal"),
    ],
)
async def test_every_failure_while_moving_stops_the_machine(error, code):
    stand_in = StandIn({Move: error})
    engine = JobEngine(stand_in)
    job = engine.submit("position", plan(Arm(), MOVE, Settle()), "me")
    await finish(engine)
    assert job.state is JobState.FAILED
    assert job.code == code
    assert len(stand_in.stops) == 1
    assert stand_in.performed == ["Arm", "Move"]


@pytest.mark.parametrize("stuck_in", [Arm, Move, Settle])
async def test_stop_at_any_request_ends_the_job_and_stops_the_machine(stuck_in):
    stand_in = StandIn({stuck_in: "forever"})
    engine = JobEngine(stand_in)
    job = engine.submit("position", plan(Arm(), MOVE, Settle()), "me")
    await asyncio.sleep(0.1)
    await engine.stop("operator pressed stop")
    assert job.state is JobState.STOPPED
    assert job.reason == "operator pressed stop"
    assert stand_in.stops[-1] == "operator pressed stop"
    assert not stand_in.may_be_moving


async def test_nothing_follows_a_stop_whose_cancellation_was_lost():
    """As Python 3.11's wait_for loses it, when what is waited for comes in the same moment."""

    class Losing(StandIn):
        async def perform(self, request):
            try:
                await super().perform(request)
            except asyncio.CancelledError:
                asyncio.current_task().uncancel()

    stand_in = Losing({Arm: "forever"})
    engine = JobEngine(stand_in)
    job = engine.submit("position", plan(Arm(), MOVE), "me")
    await asyncio.sleep(0.05)
    await engine.stop("operator pressed stop")
    assert (job.state, job.reason) == (JobState.STOPPED, "operator pressed stop")
    assert stand_in.performed == ["Arm"]


async def test_stop_without_a_job_still_stops_the_machine():
    stand_in = StandIn()
    await JobEngine(stand_in).stop("from the wall")
    assert stand_in.stops == ["from the wall"]


async def test_a_stop_that_is_never_confirmed_does_not_hang():
    stand_in = StandIn({Move: "forever"})

    async def refuse(reason):
        stand_in.stops.append(reason)
        raise LinkError("no answer")

    stand_in.stop_motion = refuse
    engine = JobEngine(stand_in)
    job = engine.submit("position", plan(MOVE), "me")
    await asyncio.sleep(0.05)
    with pytest.raises(LinkError):
        await engine.stop("now")
    assert job.state is JobState.STOPPED


async def test_a_cancelled_plan_is_closed():
    closed = []

    def guarded():
        try:
            yield Settle()
        finally:
            closed.append(True)

    engine = JobEngine(StandIn({Settle: "forever"}))
    engine.submit("look", guarded(), "me")
    await asyncio.sleep(0.05)
    await engine.stop("x")
    assert closed == [True]


async def test_planning_does_not_hold_up_the_event_loop():
    release = threading.Event()

    def heavy():
        release.wait(5.0)
        yield Settle()

    engine = JobEngine(StandIn())
    job = engine.submit("look", heavy(), "me")
    await asyncio.sleep(0.05)  # the loop turns while the plan computes
    assert job.state is JobState.RUNNING
    release.set()
    await finish(engine)
    assert job.state is JobState.DONE


@pytest.mark.parametrize("again", [1, 3])
async def test_a_job_that_is_stopped_again_while_it_ramps_still_ends(again):
    """A closed tab stops thrice: its socket, its lease, its last word. A job without an end blocks the machine."""
    ramping, at_rest = asyncio.Event(), asyncio.Event()

    class Ramping(StandIn):
        async def stop_motion(self, reason):
            self.stops.append(reason)
            ramping.set()
            await at_rest.wait()
            self.may_be_moving = False

    engine = JobEngine(Ramping({Move: "forever"}))
    job = engine.submit("park", plan(Arm(), MOVE), "me")
    await asyncio.sleep(0.05)
    stops = [asyncio.create_task(engine.stop("button up"))]
    await ramping.wait()
    stops += [asyncio.create_task(engine.stop(f"again {number}")) for number in range(again)]
    await asyncio.sleep(0.05)
    engine._task.cancel()  # and once more from outside
    await asyncio.sleep(0.05)
    at_rest.set()
    await asyncio.gather(*stops, return_exceptions=True)
    assert (job.state, job.reason) == (JobState.STOPPED, "button up")
    engine.submit("look", plan(), "me")  # the next one may begin
    await finish(engine)


async def test_a_stop_reaches_the_machine_before_the_step_under_way_has_ended():
    release = threading.Event()

    def heavy():
        yield Settle()
        release.wait(2.0)  # the machine moves meanwhile: a closed loop plans its new tail
        yield MOVE

    stand_in = StandIn()
    engine = JobEngine(stand_in)
    job = engine.submit("servo", heavy(), "me")
    await asyncio.sleep(0.05)
    stopping = asyncio.create_task(engine.stop("operator pressed stop"))
    await asyncio.sleep(0.05)
    assert stand_in.stops == ["operator pressed stop"]
    assert job.state is JobState.STOPPING
    release.set()
    await stopping
    assert job.state is JobState.STOPPED
    assert stand_in.performed == ["Settle"]  # what the step asked for is not carried out any more
    assert not stand_in.may_be_moving


async def test_what_the_last_step_set_in_motion_after_the_ramp_is_stopped_again():
    class Late(StandIn):
        async def perform(self, request):
            try:
                await asyncio.get_running_loop().create_future()
            finally:
                await asyncio.sleep(0.05)
                self.may_be_moving = True  # its trajectory was on its way already

    stand_in = Late()
    engine = JobEngine(stand_in)
    job = engine.submit("position", plan(MOVE), "me")
    await asyncio.sleep(0.05)
    await engine.stop("enough")
    assert job.state is JobState.STOPPED
    assert not stand_in.may_be_moving
    assert stand_in.stops[-1] == "enough"


async def test_a_step_does_not_wait_for_a_busy_default_executor():
    asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(1))
    free = threading.Event()
    listing = asyncio.create_task(asyncio.to_thread(free.wait, 5.0))
    await asyncio.sleep(0.02)
    engine = JobEngine(StandIn())
    job = engine.submit("look", plan(Settle()), "me")
    await asyncio.wait({engine._task}, timeout=2.0)
    assert job.state is JobState.DONE
    free.set()
    await listing


@pytest.mark.parametrize("deaf_to", ["started", "ended"])
async def test_a_listener_that_raises_does_not_keep_a_job_from_its_end(deaf_to):
    """A full disk under the recording must not block the machine, nor turn a done job into a failed one."""
    heard = []

    def full(job, event):
        if event.name == deaf_to:
            raise OSError(28, "No space left on device")

    engine = JobEngine(StandIn())
    engine.on_event(full)
    engine.on_event(lambda job, event: heard.append(event.name))
    job = engine.submit("look", plan(Settle()), "me")
    await finish(engine)
    assert (job.state, job.result) == (JobState.DONE, "done")
    assert heard == ["started", "ended"]
    assert job.job_id in engine.not_noted  # a fault: what should have written the job down did not
    assert "No space left" in engine.not_noted
    engine.submit("look", plan(), "me")
    assert engine.not_noted == ""
    await finish(engine)


async def test_a_job_that_is_stopped_before_its_first_step_ends():
    stand_in = StandIn()
    engine = JobEngine(stand_in)
    job = engine.submit("look", plan(Settle()), "me")
    await engine.stop("at once")  # in the same turn of the loop
    assert (job.state, job.reason, stand_in.performed) == (JobState.STOPPED, "at once", [])
    again = engine.submit("look", plan(Settle()), "me")
    await finish(engine)
    assert again.state is JobState.DONE


@pytest.mark.parametrize("answer", [None, "forever", JobFailedError("poor", "calibration_failed"), ValueError("bug")])
async def test_what_a_job_left_on_is_released_on_every_ending(answer):
    stand_in = StandIn({Settle: answer})
    engine = JobEngine(stand_in)
    job = engine.submit("calibrate", plan(Settle()), "me")
    await asyncio.sleep(0.05)
    await engine.stop("enough")
    assert job.has_ended
    assert stand_in.released == 1


async def test_once_it_is_closing_the_running_job_ends_and_none_begins():
    engine = JobEngine(StandIn({Settle: "forever"}))
    job = engine.submit("position", plan(Settle()), "operator")
    await asyncio.sleep(0.05)
    await engine.close()
    assert (job.state, job.reason) == (JobState.STOPPED, "server is shutting down")
    with pytest.raises(JobFailedError, match="the server is shutting down"):
        engine.submit("look", plan(Settle()), "fleet")
    assert engine.current is job
