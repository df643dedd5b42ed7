"""STOP over a socket, and which stops are written down."""

import asyncio

import pytest
from served import bench
from test_api_open_connections import Connection, until

from server.api.job_commands import STOP_AUDIT_PERIOD_S, TRACKED_ADDRESSES_MAX, FoldedStops
from server.link.errors import LinkSilentError


@pytest.fixture
def keyed(tmp_path):
    made = bench(tmp_path, keyed=True)
    yield made
    made.keeper.database.close()


def said(line):
    return [message["text"] for message in line.sent if message["type"] == "websocket.send"]


async def test_whatever_the_page_says_stops_and_is_answered(keyed):
    keyed.performer.hold = asyncio.Event()
    async with keyed.client("operator") as client:
        await client.post("/v1/jobs", json={"kind": "look"}, headers=keyed.control())
    job = keyed.service.engine.current
    line = Connection(keyed.app, "websocket", "/v1/stop", keyed.keys["viewer"])
    await line.begun()
    for number, message in enumerate(({"text": "stop"}, {"bytes": b"\x00"}, {"text": "anything"}), start=1):
        line._in.put_nowait({"type": "websocket.receive", **message})
        await until(lambda wanted=number: len(said(line)) == wanted)
    assert said(line) == ["stopped"] * 3
    assert (job.state.value, job.reason) == ("stopped", "stopped in the panel")
    line._in.put_nowait({"type": "websocket.disconnect", "code": 1001})
    await asyncio.wait_for(line.task, 10.0)


async def test_a_stop_that_was_not_confirmed_is_told_as_that_and_the_line_stays(keyed, monkeypatch):
    async def unheard(_reason):
        raise LinkSilentError("no answer")

    monkeypatch.setattr(keyed.service.engine, "stop", unheard)
    line = Connection(keyed.app, "websocket", "/v1/stop", keyed.keys["operator"])
    await line.begun()
    line._in.put_nowait({"type": "websocket.receive", "text": "stop"})
    await until(lambda: said(line))
    assert said(line) == ["not confirmed"]
    assert not line.task.done()
    line._in.put_nowait({"type": "websocket.disconnect", "code": 1001})
    await asyncio.wait_for(line.task, 10.0)


async def test_the_line_needs_a_key_where_there_are_keys(keyed):
    line = Connection(keyed.app, "websocket", "/v1/stop")
    assert (await line.over())["type"] == "websocket.close"


def test_stops_that_stop_nothing_are_counted_and_one_in_ten_seconds_is_written():
    stops = FoldedStops()
    assert stops.to_write("a", 0.0, matters=False) == 0
    assert [stops.to_write("a", 0.01 * k, matters=False) for k in range(1, 500)] == [None] * 499
    assert stops.to_write("b", 5.0, matters=False) == 0  # somebody else's
    assert stops.to_write("a", 5.0, matters=True) == 499  # this one stops a job: at once
    assert stops.to_write("a", 6.0, matters=False) is None
    assert stops.to_write("a", 5.0 + STOP_AUDIT_PERIOD_S, matters=False) == 1
    for k in range(3 * TRACKED_ADDRESSES_MAX):
        stops.to_write(f"host {k}", 20.0, matters=False)
    assert len(stops._last) <= TRACKED_ADDRESSES_MAX


async def test_a_flood_of_stops_without_a_key_leaves_one_line(keyed):
    async with keyed.client() as anybody:
        for _ in range(50):
            assert (await anybody.post("/v1/stop")).status_code == 200
    # Through the queue of the writing thread, so after the lines that wait in it.
    lines = keyed.keeper.database.write(lambda db: db.execute("SELECT * FROM audit WHERE action = 'stop'").fetchall())
    assert len(lines) == 1
