"""The server's handle on the link: a disarm is always asked for, and is done only when the PLC says so."""

import asyncio
from dataclasses import replace

import pytest

from server.link import client as module
from server.link.client import LinkClient
from server.link.contracts import ArmRequest, DisarmRequest, HealthReport, LinkHealth, LinkPhase
from server.link.errors import LinkError, LinkRefusedError, LinkSilentError
from server.link.settings import LinkSettings
from server.settings import read_machine

HEALTH = LinkHealth(LinkPhase.ARMED, 1.0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 1)


class Process:
    def __init__(self):
        self.told = []

    async def request(self, request):
        self.told.append(request)


@pytest.fixture
def link(monkeypatch):
    monkeypatch.setattr(module, "_STOP_S", 0.3)
    client = LinkClient(LinkSettings(), read_machine("hiab033"))
    client._process = Process()
    return client


def hear(link, phase):
    link._on_report(HealthReport(replace(HEALTH, phase=phase), 0))


async def asked(link, kind):
    async with asyncio.timeout(1.0):
        while not any(isinstance(request, kind) for request in link._process.told):  # noqa: ASYNC110 no event there
            await asyncio.sleep(0.001)


@pytest.mark.parametrize("before", list(LinkPhase))
async def test_a_disarm_is_always_asked_for_and_waits_for_what_the_plc_says_then(link, before):
    hear(link, before)
    disarming = asyncio.create_task(link.disarm())
    await asked(link, DisarmRequest)
    await asyncio.sleep(0.01)
    assert not disarming.done()
    hear(link, LinkPhase.OFFLINE)  # between two sessions
    await asyncio.sleep(0.01)
    assert not disarming.done()
    hear(link, LinkPhase.DISARMED)
    await disarming


async def test_a_plc_that_is_not_heard_is_not_called_disarmed(link):
    hear(link, LinkPhase.OFFLINE)
    with pytest.raises(LinkSilentError, match="did not answer"):
        await link.disarm()
    hear(link, LinkPhase.ARMED)
    disarming = asyncio.create_task(link.disarm())
    await asyncio.sleep(0.01)
    hear(link, LinkPhase.ARMED)
    with pytest.raises(LinkError, match="PLC still armed"):
        await disarming


async def test_an_arming_that_is_under_way_ends_with_the_disarm_and_arms_nothing(link):
    hear(link, LinkPhase.LINKED)
    arming = asyncio.create_task(link.arm())
    await asked(link, ArmRequest)
    disarming = asyncio.create_task(link.disarm())
    await asked(link, DisarmRequest)
    hear(link, LinkPhase.ARMED)  # the ARM had been on its way
    with pytest.raises(LinkRefusedError, match="disarmed while it was being armed"):
        await arming
    with pytest.raises(LinkRefusedError):  # nor does a new one begin beside it
        await link.arm()
    hear(link, LinkPhase.LINKED)
    await disarming
    assert [type(request) for request in link._process.told] == [ArmRequest, DisarmRequest]
    arming = asyncio.create_task(link.arm())
    await asyncio.sleep(0.01)
    hear(link, LinkPhase.ARMED)
    await arming


async def test_without_a_process_a_disarm_says_so():
    with pytest.raises(LinkSilentError):
        await LinkClient(LinkSettings(), read_machine("hiab033")).disarm()
