"""A PC that the PLC refuses, over real UDP: it is answered, and says why."""

from collections.abc import Iterator

import pytest
from test_link_process import PlcThread, settings_for, until

from machine.description import Machine
from server.link.client import LinkClient
from server.link.contracts import LinkPhase
from server.link.errors import LinkRefusedError, LinkSilentError
from server.settings import read_machine

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def machine() -> Machine:
    return read_machine("hiab033")


@pytest.fixture
def raw_plc(machine: Machine) -> Iterator[PlcThread]:
    thread = PlcThread(machine, "raw")
    thread.framing = "raw"  # type: ignore[attr-defined]
    yield thread
    thread.close()


async def test_a_second_pc_is_told_that_another_one_holds_the_plc(raw_plc: PlcThread, machine: Machine) -> None:
    first, second = (LinkClient(settings_for(raw_plc), machine) for _ in range(2))
    await first.start()
    try:
        await first.arm(timeout_s=10.0)
        await second.start()
        assert await until(lambda: bool(second.health.other_pc), 10.0)
        with pytest.raises(LinkRefusedError, match="another PC holds the PLC's session 0x"):
            await second.arm(timeout_s=1.0)
        assert await until(lambda: "another PC asks for" in first.health.other_pc, 10.0)
        assert first.health.phase is LinkPhase.ARMED
    finally:
        await first.close()
        await second.close()


async def test_a_plc_of_another_version_is_told_from_a_silent_one(raw_plc: PlcThread, machine: Machine) -> None:
    raw_plc.alter = lambda datagram: datagram[:4] + bytes([datagram[4] + 1]) + datagram[5:]  # ver_major, both ways
    link = LinkClient(settings_for(raw_plc), machine)
    await link.start()
    try:
        assert await until(lambda: bool(link.health.error), 10.0)
        with pytest.raises(LinkSilentError, match="the PLC answers, but rejects this PC: VERSION"):
            await link.arm(timeout_s=1.0)
    finally:
        await link.close()
