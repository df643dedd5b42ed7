"""Starting the link process again: as often as it takes, whatever is in the way."""

import asyncio

import pytest

from server.link import client as module
from server.link.client import LinkClient
from server.link.settings import LinkSettings
from server.settings import read_machine


class Dead:
    pid = 1

    async def end(self):
        raise ValueError("process object is closed")


@pytest.mark.parametrize("error", [OSError(24, "Too many open files"), RuntimeError("can't start new thread")])
async def test_a_start_that_fails_is_tried_again(monkeypatch, error):
    monkeypatch.setattr(module, "_RESTART_S", 0.0)
    client = LinkClient(LinkSettings(), read_machine("hiab033"))
    tries, told = [], []

    async def spawn():
        tries.append(1)
        told.append(client.health.error)
        if len(tries) < 3:
            raise error

    monkeypatch.setattr(client, "_spawn", spawn)
    client._process = dead = Dead()
    client._on_gone(dead)
    await asyncio.wait_for(client._restart, 10.0)
    assert len(tries) == 3
    assert str(error) in told[2]
    await client.close()  # of the dead one nothing is left to end
