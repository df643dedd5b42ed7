"""Connections that are kept alive: ours outlive two renewals of control, and a request that one drops is sent again."""

import socket
import threading

import httpx
import pytest
from fastapi import FastAPI

from longreach.fleet_client import JobClient
from longreach.fleet_connection import IDLE_S, SteadyClient
from longreach.lease_holder import TTL_S
from server.api import slow_clients
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
    renewal_s = TTL_S / 3.0
    assert config_of(FastAPI(), HttpSettings()).timeout_keep_alive > 2.0 * renewal_s
    assert renewal_s < slow_clients.HEADER_S  # it looks twice before it closes
    assert renewal_s > IDLE_S  # and a renewal comes on a connection of its own where the server is another one


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
