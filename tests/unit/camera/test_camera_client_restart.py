"""Starting the vision process again: as often as it takes."""

import asyncio
import multiprocessing
import threading

import pytest
from test_camera_client_process import MACHINE

from server.camera import client as module
from server.camera import process
from server.camera.client import VisionClient
from server.camera.contracts import PoseSourceCommand, QuitCommand, SignOfLife, VisionSettings
from server.camera.sources.settings import HttpSource


class Pipe:
    def close(self):
        pass


@pytest.fixture
def client(monkeypatch):
    monkeypatch.setattr(module, "RESTART_DELAY_S", 0.01)
    made = VisionClient(VisionSettings(HttpSource("http://127.0.0.1:9/stream"), threads=1), MACHINE)
    made._pipe = Pipe()
    return made


@pytest.mark.parametrize("error", [OSError(11, "Resource temporarily unavailable"), RuntimeError("no thread")])
async def test_a_start_that_fails_is_tried_again(client, monkeypatch, error):
    started = asyncio.Event()
    loop, tries, told = asyncio.get_running_loop(), [], []

    def spawn():
        tries.append(1)
        told.append(client.stream_text)
        if len(tries) < 3:
            raise error
        loop.call_soon_threadsafe(started.set)

    monkeypatch.setattr(client, "_spawn", spawn)
    client._loop = loop
    client._lost(client._pipe)
    await asyncio.wait_for(started.wait(), 10.0)
    assert len(tries) == 3
    assert told[0].startswith("vision process ended unexpectedly")
    assert told[2].startswith("vision process ended")  # as the alarm vision_ended knows it
    assert str(error) in told[2]
    await client.close()


async def test_closing_ends_the_tries(client, monkeypatch):
    monkeypatch.setattr(client, "_spawn", lambda: 1 / 0)
    client._loop = asyncio.get_running_loop()
    client._lost(client._pipe)
    await asyncio.sleep(0.05)
    await client.close()
    assert client._restart.done()


def test_a_source_that_can_never_work_is_told_once_and_lives_on(monkeypatch):
    """Else it would be taken for a process that hangs, and be started again and again."""
    monkeypatch.setattr(process, "HEARTBEAT_PERIOD_S", 0.01)
    ours, theirs = multiprocessing.Pipe()
    telling = threading.Thread(target=process._report_and_wait, args=(theirs, "no such folder"))
    telling.start()
    assert ours.recv().text == "no such folder"
    ours.send(PoseSourceCommand("stereo"))
    assert [type(ours.recv()) for _ in range(5)] == [SignOfLife] * 5
    ours.send(QuitCommand())
    telling.join(10.0)
    assert not telling.is_alive()
