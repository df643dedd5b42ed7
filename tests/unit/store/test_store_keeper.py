"""The keeper: nothing begins that is not written, every job has an honest end in the next life."""

import asyncio
import threading

import pytest

from server.access.errors import LeaseLostError
from server.access.lease import LeaseKind
from server.jobs.commands import Command, began
from server.jobs.engine import JobEngine, JobState
from server.jobs.requests import Settle
from server.store.audit_rows import AuditEntry, Caller, read_audit
from server.store.database import Database
from server.store.errors import StoreError
from server.store.given_answers import MOST, GivenAnswers
from server.store.idempotency import Answered, KeyInProgressError, KeyReusedError, read_answer, replay_of
from server.store.keeper import Keeper

FLEET = Caller("truck 7", "fleet", "10.0.0.7")


class StandIn:
    may_be_moving = False

    def __init__(self):
        self.performed = 0
        self.hold = None

    async def perform(self, request):
        self.performed += 1
        if self.hold is not None:
            await self.hold.wait()

    async def stop_motion(self, reason):
        pass

    def release(self):
        pass


def plan():
    yield Settle()
    return "arrived"


def life(tmp_path):
    """A server's life: engine and keeper on the same file."""
    keeper = Keeper(Database(tmp_path / "longreach.sqlite3"), lambda result: result)
    keeper.database.open()
    engine = JobEngine(StandIn())
    keeper.on_restored(engine.restore)
    keeper.restore()
    engine.on_event(keeper.note)
    return engine, keeper


async def start(engine, keeper, key=""):
    lease = engine.leases.held or engine.leases.acquire("truck 7", LeaseKind.FLEET, 60.0)

    async def keep(job):
        answer = Command(FLEET, "r1", key, lambda job: Answered("hash", 202, "/v1/jobs/x", job.job_id, 1.0))
        await keeper.begin(began(job, "{}", "", lease, answer))

    return await engine.submit_kept("park", plan(), "truck 7", lease, keep)


async def test_a_job_is_on_disk_before_it_begins_and_its_end_after(tmp_path):
    engine, keeper = life(tmp_path)
    engine._performer.hold = asyncio.Event()
    job = await start(engine, keeper, "key 1")
    rows = keeper.database.read(lambda db: [tuple(row) for row in db.execute("SELECT job_id, state FROM jobs")])
    assert rows == [(job.job_id, "running")]
    assert keeper.database.read(lambda db: read_answer(db, "truck 7", "key 1")).answer == job.job_id
    assert keeper.database.read(lambda db: read_audit(db, 9, 9))[0]["job_id"] == job.job_id
    engine._performer.hold.set()
    await asyncio.wait({engine._task})
    keeper.database.close()
    again, _ = life(tmp_path)
    restored = again.find(job.job_id)
    assert (restored.state, restored.result, restored.fencing) == (JobState.DONE, "arrived", 1)


async def test_a_job_without_an_end_was_interrupted_and_says_so(tmp_path):
    engine, keeper = life(tmp_path)
    engine._performer.hold = asyncio.Event()
    job = await start(engine, keeper)
    keeper.database.close()  # as far as the disk knows, the server is gone
    engine._task.cancel()
    await asyncio.wait({engine._task})
    again, keeper = life(tmp_path)
    restored = again.find(job.job_id)
    assert (restored.state, restored.code) == (JobState.INTERRUPTED, "interrupted")
    assert "watchdog" in restored.reason
    assert again.leases.acquire("anna").fencing == 2
    keeper.database.close()


async def test_control_is_numbered_above_every_earlier_life(tmp_path):
    for number in (1, 2, 3):
        engine, keeper = life(tmp_path)
        lease = engine.leases.acquire("anna")
        assert lease.fencing == number
        await keeper.control(AuditEntry(1.0, "anna", "operator", "", "lease.acquire", fencing=lease.fencing))
        keeper.database.close()
    with pytest.raises(LeaseLostError):
        life(tmp_path)[0].leases.check("a secret of an earlier life", 2)


async def test_what_cannot_be_written_is_not_begun(tmp_path):
    engine, keeper = life(tmp_path)
    keeper.database.write(lambda db: db.execute("PRAGMA query_only = 1"))
    with pytest.raises(StoreError):
        await start(engine, keeper)
    assert engine._performer.performed == 0
    assert (engine.current.state, engine.current.code) == (JobState.FAILED, "store")
    with pytest.raises(StoreError):  # and from now on without asking the disk
        keeper.check()
    keeper.database.close()


async def test_a_stop_while_it_is_written_down_stops_it_before_it_begins(tmp_path):
    engine, keeper = life(tmp_path)
    lease = engine.leases.acquire("truck 7")
    written = asyncio.Event()

    async def keep(job):
        written.set()
        await asyncio.sleep(0.05)

    starting = asyncio.create_task(engine.submit_kept("park", plan(), "truck 7", lease, keep))
    await written.wait()
    await engine.stop("not now")
    job = await starting
    assert (job.state, job.reason, engine._performer.performed) == (JobState.STOPPED, "not now", 0)
    keeper.database.close()


async def test_control_lost_while_it_is_written_down_begins_nothing(tmp_path):
    engine, keeper = life(tmp_path)
    lease = engine.leases.acquire("truck 7")

    async def keep(job):
        engine.leases.take("anna", LeaseKind.OPERATOR, "in the way")

    job = await engine.submit_kept("park", plan(), "truck 7", lease, keep)
    assert job.state is JobState.STOPPED
    assert "anna took it" in job.reason
    assert engine._performer.performed == 0
    keeper.database.close()


def test_a_key_replays_for_a_day_the_same_body_only():
    answered = Answered("same", 202, "/v1/jobs/x", "{}", 1000.0)
    assert replay_of(answered, False, "same", 1000.0 + 86_399.0) is answered
    assert replay_of(answered, False, "same", 1000.0 + 86_401.0) is None
    assert replay_of(None, False, "same", 0.0) is None
    with pytest.raises(KeyReusedError):
        replay_of(answered, False, "other", 1000.0)
    with pytest.raises(KeyInProgressError):
        replay_of(None, True, "same", 0.0)


def test_an_answer_of_this_life_is_good_whatever_the_wall_clock_says():
    """A computer that begins in 1970 and has its clock set must not move twice."""
    given, answered = GivenAnswers(), Answered("same", 202, "/v1/jobs/x", "{}", 5.0)
    given.keep(("truck 7", "k"), answered, now_mono_s=10.0)
    found = given.find(("truck 7", "k"), now_mono_s=70.0, now_unix_s=1.8e9)
    assert replay_of(found, False, "same", 1.8e9) == found
    assert found.answer == answered.answer
    assert given.find(("truck 8", "k"), 70.0, 1.8e9) is None
    assert given.find(("truck 7", "k"), 10.0 + 86_400.0, 1.8e9) is None
    for k in range(MOST + 5):
        given.keep(("truck 7", f"k{k}"), answered, 20.0)
    assert len(given._given) == MOST


async def test_a_write_that_came_after_its_refusal_leaves_no_acceptance(tmp_path, monkeypatch):
    engine, keeper = life(tmp_path)
    monkeypatch.setattr("server.store.database.WRITE_S", 0.05)
    stalled = threading.Event()
    keeper.database.submit(lambda _db: stalled.wait(10.0))
    with pytest.raises(StoreError):
        await start(engine, keeper, key="k")
    stalled.set()
    monkeypatch.setattr("server.store.database.WRITE_S", 10.0)
    keeper.database.write(lambda _db: None)  # all that was queued before it has been written
    assert keeper.database.read(lambda db: read_answer(db, FLEET.name, "k")) is None
    keeper.database.close()
