"""The keeper: nothing begins that is not written, every job has an honest end in the next life."""

import asyncio
import threading
import time

import pytest

from server.access.errors import LeaseLostError
from server.access.lease import LeaseKind
from server.access.roles import Caller
from server.jobs.engine import JobEngine, JobState
from server.jobs.keeper import Command, Keeper, job_start_rows
from server.jobs.requests import Settle
from server.store.audit_rows import AuditEntry, read_audit, read_operating_time
from server.store.database import Database, StoreError
from server.store.idempotency import (
    KeyInProgressError,
    KeyReusedError,
    StoredAnswer,
    read_answer,
    replay_of,
    save_answer,
)

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


class Clock:
    now_s = 1000.0

    def __call__(self):
        return self.now_s


def life(tmp_path, clock=time.monotonic):
    """A server's life: engine and keeper on the same file."""
    keeper = Keeper(Database(tmp_path / "longreach.sqlite3"), lambda result: result, clock)
    keeper.database.open()
    engine = JobEngine(StandIn())
    keeper.on_restored(engine.restore)
    keeper.restore()
    engine.on_event(keeper.on_job_event)
    return engine, keeper


async def start(engine, keeper, key=""):
    lease = engine.leases.held or engine.leases.acquire("truck 7", LeaseKind.FLEET, 60.0)

    async def keep(job):
        answer = Command(FLEET, "r1", key, lambda job: StoredAnswer("hash", 202, "/v1/jobs/x", job.job_id))
        await keeper.begin(job_start_rows(job, "{}", "", lease, answer))

    return await engine.submit_kept("park", plan(), "truck 7", lease, keep)


async def test_a_job_is_on_disk_before_it_begins_and_its_end_after(tmp_path):
    engine, keeper = life(tmp_path)
    engine._performer.hold = asyncio.Event()
    job = await start(engine, keeper, "key 1")
    rows = keeper.database.read(lambda db: [tuple(row) for row in db.execute("SELECT job_id, state FROM jobs")])
    assert rows == [(job.job_id, "running")]
    assert keeper.database.read(lambda db: read_answer(db, "truck 7", "key 1")).response_body == job.job_id
    assert keeper.database.read(lambda db: read_audit(db, 9, 9))[0]["job_id"] == job.job_id
    engine._performer.hold.set()
    await asyncio.wait({engine._task})
    keeper.database.close()
    again, _ = life(tmp_path)
    restored = again.find_job(job.job_id)
    assert (restored.state, restored.result, restored.fencing) == (JobState.DONE, "arrived", job.fencing)


async def test_a_job_without_an_end_was_interrupted_and_says_so(tmp_path):
    engine, keeper = life(tmp_path)
    engine._performer.hold = asyncio.Event()
    job = await start(engine, keeper)
    keeper.database.close()  # as far as the disk knows, the server is gone
    engine._task.cancel()
    await asyncio.wait({engine._task})
    again, keeper = life(tmp_path)
    restored = again.find_job(job.job_id)
    assert (restored.state, restored.code) == (JobState.INTERRUPTED, "interrupted")
    assert "watchdog" in restored.reason
    assert again.leases.acquire("anna").fencing == job.fencing + 1
    keeper.database.close()


async def test_control_is_numbered_above_every_earlier_life(tmp_path):
    numbers = []
    for _ in range(3):
        engine, keeper = life(tmp_path)
        lease = engine.leases.acquire("anna")
        numbers.append(lease.fencing)
        await keeper.control(AuditEntry(1.0, "anna", "operator", "", "lease.acquire", fencing=lease.fencing))
        keeper.database.close()
    assert numbers == [numbers[0], numbers[0] + 1, numbers[0] + 2]
    with pytest.raises(LeaseLostError):
        life(tmp_path)[0].leases.check("a secret of an earlier life", numbers[1])


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
        engine.leases.take_control("anna", LeaseKind.OPERATOR, "in the way")

    job = await engine.submit_kept("park", plan(), "truck 7", lease, keep)
    assert job.state is JobState.STOPPED
    assert "anna took it" in job.reason
    assert engine._performer.performed == 0
    keeper.database.close()


def test_a_key_replays_the_same_body_only():
    answered = StoredAnswer("same", 202, "/v1/jobs/x", "{}")
    assert replay_of(answered, False, "same") is answered
    assert replay_of(None, False, "same") is None
    with pytest.raises(KeyReusedError):
        replay_of(answered, False, "other")
    with pytest.raises(KeyInProgressError):
        replay_of(None, True, "same")


async def passed(keeper, clock, seconds):
    """Time in which the server runs: its watch looks at the disk now and then."""
    clock.now_s += seconds
    watching = asyncio.create_task(keeper.watch())
    reached = clock.now_s - keeper._zero_s
    while keeper.database.read(read_operating_time) < reached - 1e-3:  # noqa: ASYNC110
        await asyncio.sleep(0.0)
    watching.cancel()
    await asyncio.wait({watching})


async def test_a_key_is_kept_for_a_day_of_operation_over_all_lives(tmp_path, monkeypatch):
    monkeypatch.setattr("server.jobs.keeper.STORE_PROBE_PERIOD_S", 0.0)
    clock = Clock()
    engine, keeper = life(tmp_path, clock)
    job = await start(engine, keeper, "k")
    await asyncio.wait({engine._task})
    for _ in range(4):  # 24 h, less what the steps round
        keeper.database.close()
        _, keeper = life(tmp_path, clock)
        await passed(keeper, clock, 5.99 * 3600.0)
        assert keeper.database.read(lambda db: read_answer(db, FLEET.name, "k")).response_body == job.job_id
    await passed(keeper, clock, 3600.0)
    assert keeper.database.read(lambda db: read_answer(db, FLEET.name, "k")) is None
    keeper.database.close()


@pytest.mark.parametrize(("first_s", "then_s"), [(5.0, 1.8e9), (1.8e9, 5.0), (1.8e9, 1.8e9 + 400.5 * 86_400.0)])
async def test_a_wall_clock_that_is_set_erases_no_audit_and_forgets_no_key(tmp_path, monkeypatch, first_s, then_s):
    """Begun in 1970 and set later, fallen back to 1970, or a year ahead for one start."""
    monkeypatch.setattr("time.time", lambda: first_s)
    engine, keeper = life(tmp_path)
    job = await start(engine, keeper, "k")
    await asyncio.wait({engine._task})
    for number in range(15):
        keeper.queue_audit_line(AuditEntry(first_s, "anna", "operator", "", f"line {number}"))
    keeper.database.close()
    for wall_s in (then_s, first_s):
        monkeypatch.setattr("time.time", lambda wall_s=wall_s: wall_s)
        _, keeper = life(tmp_path)
        known = keeper.database.read(lambda db: read_answer(db, FLEET.name, "k"))
        assert replay_of(known, False, "hash").response_body == job.job_id
        keeper.database.write(lambda db, s=wall_s, k=known: save_answer(db, FLEET.name, f"at {s}", k))
        assert len(keeper.database.read(lambda db: read_audit(db, 99, 99))) == 16
        keeper.database.close()


async def test_a_write_that_came_after_its_refusal_leaves_no_acceptance(tmp_path, monkeypatch):
    engine, keeper = life(tmp_path)
    monkeypatch.setattr("server.store.database.WRITE_TIMEOUT_S", 0.05)
    stalled = threading.Event()
    keeper.database.submit(lambda _db: stalled.wait(10.0))
    with pytest.raises(StoreError):
        await start(engine, keeper, key="k")
    stalled.set()
    monkeypatch.setattr("server.store.database.WRITE_TIMEOUT_S", 10.0)
    keeper.database.write(lambda _db: None)  # all that was queued before it has been written
    assert keeper.database.read(lambda db: read_answer(db, FLEET.name, "k")) is None
    keeper.database.close()
