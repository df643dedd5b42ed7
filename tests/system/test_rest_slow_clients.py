"""Connections that say nothing, or half a request, are closed; others are served meanwhile."""

import contextlib
import socket
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from fastapi import WebSocket
from websockets.sync.client import connect

sys.path.insert(0, str(Path(__file__).parent))
from rest_stand import served

from server.api import connection_limit

pytestmark = [pytest.mark.system, pytest.mark.real_time]


@pytest.mark.parametrize(
    "said", [b"", b"GET /v1/state HTTP/1.1\r\nHost: 127.0", b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET /he"]
)
def test_half_a_head_is_closed_and_holds_nobody_up(tmp_path, monkeypatch, said):
    monkeypatch.setattr(connection_limit, "HTTP_HEAD_TIMEOUT_S", 0.3)
    with served(tmp_path, keyed=False) as (url, _):
        parts = urlsplit(url)
        slow = [socket.create_connection((parts.hostname, parts.port), timeout=10.0) for _ in range(50)]
        try:
            for connection in slow:
                connection.sendall(said)
            assert httpx.get(f"{url}/v1/state", timeout=10.0).status_code == 200
            for connection in slow:
                while connection.recv(65536):
                    pass  # the answer to the whole request; then the end, not a timeout
        finally:
            for connection in slow:
                connection.close()


def test_a_long_stream_is_not_taken_for_a_slow_client(tmp_path, monkeypatch):
    monkeypatch.setattr(connection_limit, "HTTP_HEAD_TIMEOUT_S", 0.1)
    with served(tmp_path, keyed=False) as (url, _):
        with httpx.stream("GET", f"{url}/v1/events", timeout=10.0) as stream:
            told = ""
            for text in stream.iter_text():
                told += text
                if told.count("event: state") >= 3:  # three seconds
                    break
        assert told.count("event: state") >= 3


def test_a_kept_alive_connection_that_asks_steadily_stays_open(tmp_path, monkeypatch):
    monkeypatch.setattr(connection_limit, "HTTP_HEAD_TIMEOUT_S", 0.4)
    with served(tmp_path, keyed=False) as (url, _):
        parts = urlsplit(url)
        with socket.create_connection((parts.hostname, parts.port), timeout=10.0) as connection:
            for _ in range(100):  # 2 s and five looks, nearly all of which find it waiting for a head
                connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
                said = b""
                while not said.endswith(b'{"status":"ok"}'):
                    said += (more := connection.recv(65536))
                    assert more, "closed between two requests"
                time.sleep(0.02)


def test_a_head_without_end_is_refused_before_it_fills_the_memory(tmp_path):
    with served(tmp_path, keyed=False) as (url, _):
        at = urlsplit(url).hostname, urlsplit(url).port
        with socket.create_connection(at, timeout=10.0) as connection, pytest.raises(ConnectionError):
            connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Long: " + b"a" * 64_000_000)


def test_the_largest_body_is_no_long_head(tmp_path, monkeypatch):
    monkeypatch.setattr(connection_limit, "HTTP_HEAD_MAX_BYTES", 1000)
    with served(tmp_path, keyed=False) as (url, _), httpx.Client(timeout=10.0) as client:
        for _ in range(5):
            assert client.post(f"{url}/v1/jobs", content=b"x" * 5000).status_code == 422


def test_a_websocket_that_says_nothing_stays_open(tmp_path, monkeypatch):
    monkeypatch.setattr(connection_limit, "HTTP_HEAD_TIMEOUT_S", 0.1)
    with served(tmp_path, keyed=False) as (url, made):

        @made.app.websocket("/v1/echo")
        async def echo(socket: WebSocket) -> None:
            await socket.accept()
            await socket.send_text(await socket.receive_text())

        with connect(url.replace("http", "ws") + "/v1/echo") as opened:
            time.sleep(0.6)
            opened.send("still there")
            assert opened.recv(timeout=10.0) == "still there"


def test_a_stop_is_answered_beside_more_idle_connections_than_there_may_be(tmp_path, monkeypatch):
    monkeypatch.setattr(connection_limit.PatientProtocol, "connections_max", 20)
    with served(tmp_path, keyed=False) as (url, _):
        parts = urlsplit(url)
        idle = [socket.create_connection((parts.hostname, parts.port), timeout=10.0) for _ in range(60)]
        try:
            assert httpx.post(f"{url}/v1/stop", timeout=10.0).status_code == 200
            for connection in idle[:45]:  # the oldest were closed for the others, the newest may be open
                with contextlib.suppress(ConnectionError):
                    assert connection.recv(1) == b""
        finally:
            for connection in idle:
                connection.close()
