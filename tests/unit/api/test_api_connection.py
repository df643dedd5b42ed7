"""Connections that are kept alive: ours outlive two renewals of control, and a request that one drops is sent again."""

import socket
import threading
from types import SimpleNamespace

import httpx
import pytest
from fastapi import FastAPI

from longreach.fleet_client import KEEPALIVE_EXPIRY_S, LEASE_TTL_S, JobClient, SteadyClient
from server.api import connection_limit
from server.api.connection_limit import ExhaustionLog, most_connections, one_to_close
from server.app import config_of
from server.settings import HttpSettings

ANSWER = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 2\r\n\r\n{}"


class OneAnswerEach:
    """Answers the first request of every connection as if more were welcome, and closes it on reading the second."""

    def __init__(self) -> None:
        self.seen: list[str] = []
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listening.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return  # closed by the test
            with connection:
                if self._read(connection):
                    connection.sendall(ANSWER)
                    self._read(connection)

    def _read(self, connection: socket.socket) -> bool:
        head = b""
        while b"\r\n\r\n" not in head:
            part = connection.recv(65536)
            if not part:
                return False
            head += part
        self.seen.append(head.split(b" HTTP")[0].decode())
        return True

    def close(self) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()


@pytest.fixture
def stand():
    made = OneAnswerEach()
    yield made
    made.close()


def test_the_server_keeps_a_connection_longer_than_two_renewals_of_control():
    renewal_s = LEASE_TTL_S / 3.0
    assert config_of(FastAPI(), HttpSettings()).timeout_keep_alive > 2.0 * renewal_s
    assert renewal_s < connection_limit.HTTP_HEAD_TIMEOUT_S  # it looks twice before it closes
    assert (
        renewal_s > KEEPALIVE_EXPIRY_S
    )  # and a renewal comes on a connection of its own where the server is another one


@pytest.mark.parametrize("method", ["GET", "PUT", "DELETE"])
def test_an_idempotent_request_is_sent_again_once(stand, method):
    with SteadyClient(stand.url, 5.0) as http:
        http.get("/first")
        assert http.request(method, "/second").status_code == 200
    assert stand.seen == ["GET /first", f"{method} /second", f"{method} /second"]


def test_another_request_is_not(stand):
    with SteadyClient(stand.url, 5.0) as http:
        http.get("/first")
        with pytest.raises(httpx.TransportError):
            http.post("/second", headers={"Idempotency-Key": "1"})
    assert stand.seen == ["GET /first", "POST /second"]


def test_twice_dropped_is_told(stand):
    def drop(_request: httpx.Request) -> httpx.Response:
        sent.append(1)
        raise httpx.RemoteProtocolError("Server disconnected without sending a response.")

    sent: list[int] = []
    with SteadyClient(stand.url, 5.0) as http:
        http._transport = httpx.MockTransport(drop)
        http._mounts.clear()
        with pytest.raises(httpx.RemoteProtocolError):
            http.get("/first")
    assert len(sent) == 2


def test_a_stop_is_sent_again(stand):
    with JobClient(stand.url) as client:
        assert client.state() == {}
        client.stop()
    assert stand.seen == ["GET /v1/state", "POST /v1/stop", "POST /v1/stop"]


class Transport:
    def __init__(self):
        self.aborted = False

    def is_closing(self):
        return self.aborted


class Open:
    """A connection as uvicorn holds it; a WebSocket knows neither idle nor since."""

    def __init__(self, address, since_s=None, idle=True):
        self.client, self.transport = (address, 1), Transport()
        if since_s is not None:
            self.since_s, self.is_idle = since_s, idle


def test_idle_connections_of_the_busiest_address_give_way_and_no_other():
    pc = [Open("10.0.0.5", 0.0), Open("10.0.0.5", 0.1, idle=False), Open("10.0.0.5")]
    attacker = [Open("10.0.0.9", 5.0 - number) for number in range(8)]
    assert one_to_close([*pc, *attacker], 16) is None
    assert one_to_close([*pc, *attacker], 15) is attacker[-1]  # more than half of one address; idle longest
    busy = [Open("10.0.0.9", 5.0 - number, idle=False) for number in range(8)]
    assert one_to_close([*pc, *busy, attacker[0]], 8) is attacker[0]
    assert one_to_close([*pc, *busy], 8) is busy[-1]
    sockets = [Open("10.0.0.9") for _ in range(8)]
    assert one_to_close([*pc, *sockets], 8) is sockets[0]


def test_many_addresses_share_what_there_is():
    one_each = [Open(f"10.0.1.{number}", float(number)) for number in range(20)]
    assert one_to_close(one_each, 20) is None
    assert one_to_close(one_each, 19) is not None
    assert one_to_close([], 0) is None


@pytest.mark.parametrize(("descriptors", "most"), [(1024, 640), (256, 64), (32, 16), (10**6, 4096), (-1, 4096)])
def test_the_limit_leaves_descriptors_for_the_server_itself(descriptors, most):
    assert most_connections(descriptors) == most


def test_descriptors_that_are_used_up_are_one_line_a_second(caplog, monkeypatch):
    now_s, handle = [100.0], ExhaustionLog()
    monkeypatch.setattr("server.api.connection_limit.time.monotonic", lambda: now_s[0])
    passed = []
    loop = SimpleNamespace(default_exception_handler=passed.append)
    context = {"message": "socket.accept() out of system resource", "exception": OSError(24, "Too many open files")}
    for step in range(2500):
        now_s[0] = 100.0 + step * 1e-3
        handle(loop, context)
    assert len(caplog.records) == 3
    assert "ulimit -n" in caplog.text
    handle(loop, {"message": "Task exception was never retrieved", "exception": ValueError()})
    assert len(passed) == 1
