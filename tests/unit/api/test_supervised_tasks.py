"""What always runs beside the requests: a loop that ends is told as a fault and started again; jobs do not outlive
their guard."""

import asyncio

import pytest

from server import supervised_tasks
from server.api.oversight import fault_views
from server.jobs import lease_guard
from server.supervised_tasks import SupervisedTasks


async def until(condition, timeout_s=10.0):
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110 several tasks have to run
            await asyncio.sleep(0.005)


@pytest.fixture
async def tasks():
    made = SupervisedTasks()
    yield made
    await made.close()


async def cancelled_within():
    future = asyncio.get_running_loop().create_future()
    future.cancel()
    await future


async def returns():
    return


async def fails():
    raise OSError(24, "Too many open files")


@pytest.mark.parametrize(
    ("loop", "why"), [(fails, "OSError"), (returns, "it returned"), (cancelled_within, "cancelled from within")]
)
async def test_a_loop_that_ends_is_told_and_started_again(tasks, monkeypatch, caplog, loop, why):
    begun = []
    assert tasks.recent_failure == ""

    async def twice_bad():
        begun.append(1)
        if len(begun) < 3:
            await loop()
        else:
            await asyncio.Event().wait()

    tasks.start("store-watch", twice_bad)
    await until(lambda: len(begun) == 3)
    assert f"store-watch failed ({why})" in tasks.recent_failure
    monkeypatch.setattr(supervised_tasks, "FAILURE_REPORT_DURATION_S", 0.0)
    assert tasks.recent_failure == ""


async def test_the_back_off_grows_and_is_bounded(tasks, monkeypatch):
    waits = []
    sleep = asyncio.sleep

    async def noted(delay_s):
        waits.append(delay_s)
        await sleep(0)

    monkeypatch.setattr(supervised_tasks.asyncio, "sleep", noted)
    tasks.start("event-feed", returns)
    while len(waits) < 7:
        await sleep(0)
    assert waits[:7] == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0])


async def test_a_job_does_not_outlive_its_lease_guard(open_bench, monkeypatch):
    """The guard fails once while a job runs: the job is stopped, the fault is shown, and the guard is there again."""
    enforce, calls = lease_guard.enforce_lease, []

    async def once_bad(engine):
        calls.append(1)
        if engine.current is not None and not engine.current.has_ended and not failed:
            failed.append(1)
            raise RuntimeError("a defect")
        await enforce(engine)

    failed = []
    monkeypatch.setattr(lease_guard, "enforce_lease", once_bad)
    open_bench.performer.hold = asyncio.Event()
    async with open_bench.running.tasks():
        async with open_bench.client() as client:
            started = await client.post("/v1/jobs", json={"kind": "park"}, headers=open_bench.control())
            assert started.status_code == 202
        job = open_bench.service.engine.current
        await until(lambda: job.has_ended)
        assert "lease guard failed" in job.reason
        faults = {fault.fault_id: fault for fault in fault_views(open_bench.service)}
        assert "lease-guard failed (RuntimeError)" in faults["server_part_failed"].text
        seen = len(calls)
        await until(lambda: len(calls) > seen + 1)
    assert len(open_bench.service.engine.leases._listeners) == 1  # the event feed's: each guard took its own away
