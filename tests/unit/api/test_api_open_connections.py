"""What lasts: a revoked key or a session that ended closes connections within a second, a hold and a lease end."""

import asyncio
import time

import pytest
from served import HOST

from server.access.keys import read_keys, without_key, write_keys
from server.api import guard
from server.jobs.lease_guard import guard_lease


@pytest.fixture(autouse=True)
def _soon(monkeypatch):
    monkeypatch.setattr(guard, "ACCESS_CHECK_PERIOD_S", 0.02)
    monkeypatch.setattr("server.access.keys.KEY_FILE_CHECK_PERIOD_S", 0.02)


async def until(condition):
    async with asyncio.timeout(10.0):
        while not condition():  # noqa: ASYNC110 several tasks have to run
            await asyncio.sleep(0.005)


class Connection:
    """The server's side of one connection, as uvicorn gives it to an application."""

    def __init__(self, app, kind, path, key="", cookie="", method="GET"):
        headers = [(b"host", HOST.encode())]
        headers += [(b"authorization", f"Bearer {key}".encode())] if key else []
        headers += [(b"cookie", cookie.encode())] if cookie else []
        scope = {"type": kind, "method": method, "path": path, "raw_path": path.encode(), "headers": headers}
        scope |= {"client": ("10.0.0.9", 1), "query_string": b"", "subprotocols": [], "asgi": {"version": "3.0"}}
        scope |= {"http_version": "1.1", "scheme": "http" if kind == "http" else "ws", "root_path": ""}
        self.sent, self._in = [], asyncio.Queue()
        if kind == "websocket":
            self._in.put_nowait({"type": "websocket.connect"})
        self.task = asyncio.create_task(app(scope, self._in.get, self._send))

    async def _send(self, message):
        self.sent.append(message)
        if message["type"] == "websocket.close":
            self._in.put_nowait({"type": "websocket.disconnect", "code": message["code"]})

    async def begun(self):
        await until(lambda: self.sent)

    async def over(self):
        await asyncio.wait_for(self.task, 10.0)
        return self.sent[-1]


def revoke(keyed, name):
    file = keyed.gatekeeper.keys.path
    write_keys(file, without_key(read_keys(file), name, time.time()))


@pytest.mark.parametrize("path", ["/v1/live", "/v1/video", "/v1/hold"])
async def test_a_revoked_key_closes_an_open_socket(keyed, path):
    connection = Connection(keyed.app, "websocket", path, keyed.keys["operator"])
    await connection.begun()
    await asyncio.sleep(0.1)
    assert connection.sent == [{"type": "websocket.accept", "subprotocol": None, "headers": []}]
    revoke(keyed, "operator 1")
    assert (await connection.over())["code"] == 4401


@pytest.mark.parametrize("path", ["/v1/events"])
async def test_a_revoked_key_ends_what_is_being_read(keyed, path):
    connection = Connection(keyed.app, "http", path, keyed.keys["fleet"])
    other = Connection(keyed.app, "http", path, keyed.keys["viewer"])
    await connection.begun()
    await other.begun()
    revoke(keyed, "fleet 1")
    assert await connection.over() == {"type": "http.response.body", "body": b"", "more_body": False}
    assert not other.task.done()
    assert keyed.gatekeeper._lockout.locked_s("10.0.0.9", time.monotonic()) == 0.0
    other.task.cancel()
    await asyncio.gather(other.task, return_exceptions=True)


async def test_logging_out_closes_what_the_session_opened(keyed):
    async with keyed.client() as client:
        await client.post("/v1/session", data={"key": keyed.keys["operator"]})
        cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
        socket = Connection(keyed.app, "websocket", "/v1/live", cookie=cookie)
        await socket.begun()
        assert (await client.delete("/v1/session")).status_code == 204
        assert (await socket.over())["code"] == 4401


async def test_a_motion_that_a_revoked_key_holds_is_stopped(keyed):
    keyed.performer.hold = asyncio.Event()
    lease = keyed.service.engine.leases.acquire("anna", ttl_s=60.0)
    connection = Connection(keyed.app, "websocket", "/v1/hold", keyed.keys["operator"])
    press = f'{{"press": {{"kind": "park"}}, "lease_id": "{lease.lease_id}", "fencing": {lease.fencing}}}'
    connection._in.put_nowait({"type": "websocket.receive", "text": press})
    await until(lambda: keyed.performer.performed)
    revoke(keyed, "operator 1")
    await connection.over()
    assert keyed.service.engine.current.has_ended
    assert "hold-to-run" in keyed.service.engine.current.reason


async def leased_and_parking(keyed, client):
    """Control for two minutes, and a job under it that goes on until it is stopped."""
    keyed.performer.hold = asyncio.Event()
    body = {"owner": "truck 7", "kind": "operator" if client.cookies else "fleet", "ttl_s": 120.0}
    lease = (await client.post("/v1/lease", json=body)).json()
    headers = {"Longreach-Lease": lease["lease_id"], "Longreach-Fencing": str(lease["fencing"])}
    headers["Idempotency-Key"] = "k1"
    job = {"kind": "park", "wall_free": True}
    assert (await client.post("/v1/jobs", json=job, headers=headers)).status_code == 202
    await until(lambda: keyed.performer.performed)
    return lease


@pytest.fixture
async def guarded(keyed):
    guard = asyncio.create_task(guard_lease(keyed.service.engine))
    yield keyed
    guard.cancel()
    await asyncio.gather(guard, return_exceptions=True)


async def test_a_revoked_key_loses_its_control_and_its_job_is_stopped(guarded):
    async with guarded.client("fleet") as client:
        await leased_and_parking(guarded, client)
        await asyncio.sleep(0.3)
        assert not guarded.service.engine.current.has_ended
        revoke(guarded, "fleet 1")
        await until(lambda: guarded.service.engine.current.has_ended)
    assert "the key of truck 7 is no longer valid" in guarded.service.engine.current.reason
    assert guarded.service.engine.leases.held is None


async def test_logging_out_gives_up_control(guarded):
    async with guarded.client() as client:
        await client.post("/v1/session", data={"key": guarded.keys["operator"]})
        await leased_and_parking(guarded, client)
        await client.delete("/v1/session")
        await until(lambda: guarded.service.engine.current.has_ended)
    assert "the session has ended" in guarded.service.engine.current.reason


async def test_control_kept_alive_by_another_key_outlives_the_first(guarded):
    async with guarded.client("fleet") as client, guarded.client("operator") as other:
        lease = await leased_and_parking(guarded, client)
        assert (await other.put(f"/v1/lease/{lease['lease_id']}")).status_code == 200
        revoke(guarded, "fleet 1")
        await asyncio.sleep(0.3)
        assert not guarded.service.engine.current.has_ended
        revoke(guarded, "operator 1")
        await until(lambda: guarded.service.engine.current.has_ended)


async def test_without_keys_nothing_is_looked_at_again(open_bench, monkeypatch):
    monkeypatch.setattr(open_bench.gatekeeper, "admits_still", lambda *_: 1 / 0)
    connection = Connection(open_bench.app, "websocket", "/v1/live")
    await connection.begun()
    await asyncio.sleep(0.1)
    assert not connection.task.done()
    connection._in.put_nowait({"type": "websocket.disconnect", "code": 1000})
    await asyncio.wait_for(connection.task, 10.0)
