"""The live channel: the newest state for whoever keeps up; fewer of them, never older ones, for whoever does not."""

import asyncio
import json
from types import SimpleNamespace

import pytest
from fastapi import WebSocketDisconnect

from server.api.live import MESSAGES_IN_FLIGHT_MAX, LiveFeed, live_router


class Memory:
    """Counts its states; a page may be looking."""

    def __init__(self):
        self.n_viewers, self.made, self.scrubbed = 0, 0, []

    def live_message(self):
        self.made += 1
        return SimpleNamespace(model_dump_json=lambda made=self.made: json.dumps({"state": made}))

    def scrub(self, frac):
        self.scrubbed.append(frac)


class Socket:
    def __init__(self):
        self.headers = {"host": "here", "origin": "http://here"}
        self.said, self.heard = asyncio.Queue(), []

    async def accept(self):
        pass

    async def send_text(self, text):
        self.heard.append(json.loads(text)["state"])

    async def receive_text(self):
        said = await self.said.get()
        if said is None:
            raise WebSocketDisconnect(1006)
        return said


async def turns(count=20):
    for _ in range(count):
        await asyncio.sleep(0)


@pytest.fixture
async def looking():
    """A page on the channel: (memory, tick, socket, its task)."""
    memory, socket = Memory(), Socket()
    feed = LiveFeed(memory)
    (route,) = live_router(memory, feed).routes
    task = asyncio.create_task(route.endpoint(socket))
    await turns()

    async def tick():
        feed._tick()
        await turns()

    yield memory, tick, socket, task
    task.cancel()


async def test_a_page_that_does_not_keep_up_misses_states_and_gets_the_newest_next(looking):
    _, tick, socket, _ = looking
    for _ in range(30):
        await tick()
    assert socket.heard == [1, 2]
    assert len(socket.heard) == MESSAGES_IN_FLIGHT_MAX
    socket.said.put_nowait('{"seen": true}')
    await turns()
    await tick()
    assert socket.heard == [1, 2, 31]


async def test_a_page_that_keeps_up_gets_every_state(looking):
    memory, tick, socket, _ = looking
    for _ in range(10):
        await tick()
        socket.said.put_nowait('{"seen": true}')
        await turns()
    assert socket.heard == list(range(1, 11))
    assert memory.n_viewers == 1


@pytest.mark.parametrize("said", ["nonsense", "[1]", '{"scrub": "far"}', '{"scrub": null}', "7"])
async def test_what_is_not_understood_is_passed_over(looking, said):
    memory, _, socket, task = looking
    socket.said.put_nowait(said)
    socket.said.put_nowait('{"scrub": 0.5}')
    await turns()
    assert memory.scrubbed == [0.5]
    assert not task.done()


async def test_a_page_that_goes_is_forgotten_also_while_nothing_is_sent_to_it(looking):
    memory, tick, socket, task = looking
    for _ in range(5):
        await tick()
    socket.said.put_nowait(None)
    await asyncio.wait_for(task, 5.0)
    assert memory.n_viewers == 0
