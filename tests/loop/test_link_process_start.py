"""Where the link process cannot listen, and what a terminal sends to it."""

import asyncio
import os
import signal
import socket

import pytest
from test_link_process import until

from recording.clock import mono_ns
from server.link.client import LinkClient
from server.link.contracts import LinkPhase
from server.link.settings import LinkSettings
from server.settings import read_machine

pytestmark = [pytest.mark.system, pytest.mark.real_time]


async def test_a_taken_port_is_named_without_a_traceback_and_used_when_it_is_free() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        client = LinkClient(LinkSettings(local_host="127.0.0.1", local_port=port), read_machine("hiab033"))
        starting = asyncio.create_task(client.start())
        assert await until(lambda: "restarting" in client.health.error, 40.0)
        assert f"udp 127.0.0.1:{port}: Address already in use" in client.health.error
    try:
        await starting
        assert client.health.phase is LinkPhase.OFFLINE
    finally:
        await client.close()


async def test_what_a_terminal_sends_to_all_reaches_the_server_only() -> None:
    """Else Ctrl-C would end the link process, and the server start another one while it ends itself."""
    client = LinkClient(LinkSettings(local_host="127.0.0.1", local_port=0), read_machine("hiab033"))
    await client.start()
    try:
        pid = client.process_id
        assert pid is not None
        for number in (signal.SIGINT, signal.SIGHUP):
            os.kill(pid, number)
        reported_ns = mono_ns()
        assert await until(lambda: client._t_health_ns > reported_ns + 300_000_000, 10.0)
        assert client.process_id == pid
    finally:
        await client.close()
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ()) & {signal.SIGINT, signal.SIGHUP}
