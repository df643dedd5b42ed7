"""The load bench: what its clients see of a real server, and its verdict. How good the figures are decides no test."""

import asyncio
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from rest_stand import served

from benchmarks.server.load.block import Block, block_from, verdict_of
from benchmarks.server.load.clients import ClientProcess, Demand, demand
from benchmarks.server.load.command import held, line, summary
from benchmarks.server.load.http_client import Connection

pytestmark = [pytest.mark.system, pytest.mark.real_time]


@pytest.fixture(scope="module")
def port(tmp_path_factory) -> int:
    with served(tmp_path_factory.mktemp("served"), keyed=False) as (url, _):
        yield urlsplit(url).port


def test_every_question_is_counted_and_every_reader_hears_something(port):
    looks = []
    asked = Demand(port, readers=5, rate_hz=40.0, seconds=1.5)
    with ClientProcess(asked) as clients:
        seen = clients.demand(lambda: looks.append(1))
    assert len(seen.latencies_us) == 60
    assert seen.statuses == {200: 60}
    assert all(us > 0 for us in seen.latencies_us)
    assert (seen.broken, seen.readers_at_end) == (0, 5)
    assert seen.reader_events_min >= 1  # each is greeted
    assert seen.cpu_s > 0.0
    assert looks


def test_a_server_that_is_not_there_is_told_as_unanswered_questions_and_lost_readers():
    async def closed_port() -> int:
        server = await asyncio.start_server(lambda *_: None, "127.0.0.1", 0)
        number = server.sockets[0].getsockname()[1]
        server.close()
        await server.wait_closed()
        return number

    seen = asyncio.run(demand(Demand(asyncio.run(closed_port()), readers=2, rate_hz=20.0, seconds=0.5)))
    assert seen.latencies_us == [-1] * 10
    assert seen.readers_at_end == 0
    assert not seen.statuses


def test_one_connection_asks_many_times(port):
    async def ask():
        connection = await Connection.opened("127.0.0.1", port)
        answers = [await connection.get(path) for path in ("/healthz", "/v1/state", "/v1/nothing", "/healthz")]
        connection.close()
        return answers

    answers = asyncio.run(ask())
    assert [one.status for one in answers] == [200, 200, 404, 200]
    assert answers[0].body == answers[3].body == b'{"status":"ok"}'


def a_block(**changed) -> Block:
    values = {
        "number": 1,
        "clients": True,
        "seconds": 10.0,
        "pairs": 190.0,
        "replay_hz": 20.0,
        "underruns": 0,
        "run_frac": 0.6,
        "jobs": {"park done": 1},
        "cpu_frac": {"server": 0.2},
        "load_average": 1.0,
        "latencies_us": [4000] * 99 + [90_000],
        "statuses": {"200": 100},
        "broken": 0,
        "late_start_max_us": 10,
        "events": 100,
        "event_bytes": 1000,
        "readers_at_end": 50,
        "reader_events_min": 2,
    }
    return block_from(values | {"of a later version": 1} | changed)


QUIET = a_block(clients=False, pairs=200.0, latencies_us=[], statuses={}, readers_at_end=0)


def test_the_verdict_adds_up():
    good = a_block(latencies_us=[4000] * 999 + [90_000], statuses={"200": 1000})
    verdict = verdict_of([QUIET, good], readers=50)
    assert verdict.holds
    assert (verdict.p50_ms, verdict.p99_ms, verdict.max_ms) == (4.0, 4.0, 90.0)
    assert verdict.lost_frac == pytest.approx(0.05)
    assert verdict.lost_by_clients_frac == pytest.approx(0.05)
    assert "holds" in summary(verdict)
    assert "19.0 pairs/s" in line(good)


@pytest.mark.parametrize(
    "changed",
    [
        {"latencies_us": [4000] * 98 + [90_000] * 2},
        {"latencies_us": [4000] * 999 + [-1]},
        {"underruns": 1},
        {"pairs": 179.0},
        {"readers_at_end": 49},
        {"statuses": {"200": 99, "503": 1}},
        {"latencies_us": []},
    ],
)
def test_each_limit_can_be_missed(changed):
    base = {"latencies_us": [4000] * 1000, "statuses": {"200": 1000}}
    assert verdict_of([QUIET, a_block(**base)], readers=50).holds
    verdict = verdict_of([QUIET, a_block(**(base | changed))], readers=50)
    assert not verdict.holds
    assert "DOES NOT HOLD" in summary(verdict)


def test_the_rate_replayed_is_one_that_a_camera_has():
    assert [held(rate) for rate in (70.0, 43.4, 30.0, 29.9, 15.0, 9.0)] == [60.0, 30.0, 30.0, 15.0, 15.0, 15.0]
