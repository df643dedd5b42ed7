"""The table of attacks of docs/security.md, a test each (its name is in the table)."""

import asyncio
import logging

import pytest
from served import HOST

from server.access.keys import KeyRing, new_key, read_keys, with_key, without_key, write_keys
from server.access.roles import Role
from server.api import guard as guard_module
from server.api.oversight import fault_views
from server.app import gatekeeper_of
from server.errors import SettingsError
from server.settings import HttpSettings

PARK = {"kind": "park"}
LEASE = {"owner": "mallory"}


async def socket_of(app, path, origin):
    """What a WebSocket is answered at once."""
    headers = [(b"host", HOST.encode()), (b"origin", origin.encode())]
    scope = {"type": "websocket", "path": path, "headers": headers, "client": ("10.0.0.9", 1), "query_string": b""}
    sent = []

    async def send(message):
        sent.append((message["type"], message.get("code")))

    async def receive():
        return {"type": "websocket.connect"}

    await app(scope | {"asgi": {"version": "3.0"}, "subprotocols": []}, receive, send)
    return sent


async def test_no_key_sees_and_moves_nothing_but_may_stop(keyed):
    async with keyed.client() as client:
        for method, path in [
            ("GET", "/v1/state"),
            ("GET", "/metrics"),
            ("GET", "/v1/openapi.json"),
            ("GET", "/nothing"),
        ]:
            answer = await client.request(method, path)
            assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized"), path
            assert answer.headers["www-authenticate"] == "Bearer"
        assert (await client.post("/v1/lease", json=LEASE)).status_code == 401
        assert (await client.post("/v1/jobs", json=PARK)).status_code == 401
        assert (await client.get("/healthz")).status_code == 200
        assert (await client.post("/v1/stop")).status_code == 200
        assert (await client.post("/v1/stop", headers={"Authorization": "Bearer wrong"})).status_code == 200
        page = await client.get("/", headers={"Accept": "text/html"})
        assert (page.status_code, page.headers["location"]) == (303, "login")
    assert len(keyed.service.cell.link.stops) == 2


@pytest.mark.parametrize(
    ("role", "may"),
    [
        ("viewer", {"GET /v1/state": 200, "GET /v1/audit": 403, "POST /v1/lease": 403, "POST /v1/diagnoses": 403}),
        ("operator", {"GET /v1/state": 200, "GET /v1/audit": 200, "POST /v1/lease": 201, "POST /v1/diagnoses": 404}),
        ("fleet", {"GET /v1/state": 200, "GET /v1/audit": 403, "POST /v1/lease": 403, "POST /v1/diagnoses": 403}),
        ("engineer", {"GET /v1/state": 200, "GET /v1/audit": 200, "POST /v1/lease": 201, "POST /v1/diagnoses": 404}),
        ("admin", {"GET /v1/state": 200, "GET /v1/audit": 200, "POST /v1/lease": 201, "POST /v1/diagnoses": 404}),
    ],
)
async def test_each_role_does_what_is_its_own(keyed, role, may):
    bodies = {"/v1/lease": LEASE, "/v1/diagnoses": {"run_id": "none"}}
    async with keyed.client(role) as client:
        for request, status in may.items():
            method, path = request.split()
            assert (await client.request(method, path, json=bodies.get(path))).status_code == status, request


async def test_a_fleet_key_gets_control_as_a_fleet_only_and_does_not_take_it(keyed):
    async with keyed.client("fleet") as client:
        assert (await client.post("/v1/lease", json={"owner": "truck 7", "kind": "fleet"})).status_code == 201
        for kind in ("operator", "engineer"):
            forged = {"owner": "anna", "kind": kind, "reason": "hurry"}
            assert (await client.post("/v1/lease/take", json=forged)).status_code == 403
    async with keyed.client("operator") as client:
        assert (await client.post("/v1/lease", json={"owner": "anna", "kind": "engineer"})).status_code == 403


@pytest.mark.parametrize("role", ["operator", "engineer", "admin"])
async def test_a_persons_key_gets_no_control_as_a_fleet_and_so_no_motion_without_the_hold(keyed, role):
    async with keyed.client(role) as client:
        answer = await client.post("/v1/lease", json={"owner": "anna", "kind": "fleet"})
        assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")


async def test_a_stolen_stale_lease_moves_nothing(keyed):
    async with keyed.client("fleet") as fleet, keyed.client("operator") as operator:
        lease = (await fleet.post("/v1/lease", json={"owner": "truck 7", "kind": "fleet"})).json()
        await operator.post("/v1/lease/take", json={"owner": "anna", "reason": "shift"})
        stolen = {
            "Longreach-Lease": lease["lease_id"],
            "Longreach-Fencing": str(lease["fencing"]),
            "Idempotency-Key": "k",
        }
        for number in (lease["fencing"], lease["fencing"] + 1):
            answer = await fleet.post("/v1/jobs", json=PARK, headers=stolen | {"Longreach-Fencing": str(number)})
            assert (answer.status_code, answer.json()["code"]) == (409, "lease_lost")
            assert answer.json()["references"]["owner"] == "anna"
    assert not keyed.service.engine.jobs


async def test_a_replayed_command_moves_nothing_a_second_time(keyed):
    async with keyed.client("fleet") as fleet:
        lease = (await fleet.post("/v1/lease", json={"owner": "truck 7", "kind": "fleet"})).json()
        headers = {
            "Longreach-Lease": lease["lease_id"],
            "Longreach-Fencing": str(lease["fencing"]),
            "Idempotency-Key": "k",
        }
        answers = []
        for _ in range(3):
            answers.append(await fleet.post("/v1/jobs", json=PARK, headers=headers))
            await keyed.settled()
    assert len({answer.text for answer in answers}) == 1
    assert len(keyed.service.engine.jobs) == 1


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "ftp://127.0.0.1:8080", "http://["]
)
async def test_a_foreign_origin_commands_nothing(open_bench, origin):
    async with open_bench.client() as client:
        for path in ("/v1/lease", "/v1/stop", "/v1/jobs"):
            answer = await client.post(path, json=LEASE, headers={"Origin": origin})
            assert (answer.status_code, answer.json()["code"]) == (403, "foreign_origin")
        assert (await client.post("/v1/stop", headers={"Origin": f"http://{HOST}"})).status_code == 200
    assert await socket_of(open_bench.app, "/v1/live", origin) == [("websocket.close", 4403)]


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "", "[", "127.0.0.1@evil"]
)
async def test_a_rebound_name_reaches_nothing(open_bench, host):
    async with open_bench.client() as client:
        for path in ("/v1/state", "/healthz"):
            assert (await client.get(path, headers={"Host": host})).json()["code"] == "foreign_host"
        for ours in ("localhost:8080", "192.168.7.3", "[::1]:8080"):
            assert (await client.get("/healthz", headers={"Host": ours})).status_code == 200


async def test_an_oversized_body_is_refused_whole_or_in_pieces(open_bench):
    async def pieces():
        for _ in range(100):
            yield b"x" * 1024

    async with open_bench.client() as client:
        for content in (b"x" * 70_000, pieces()):
            answer = await client.post("/v1/jobs", content=content)
            assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")


@pytest.mark.parametrize("run_id", ["..%2fkeys", "%2e%2e%2fkeys", "..", ".hidden", "a%00b", "%2fetc%2fpasswd", "link"])
async def test_a_run_id_never_leaves_the_folder(keyed, tmp_path, run_id):
    (tmp_path / "keys.mcap").write_bytes(b"outside")
    (tmp_path / "runs" / ".hidden.mcap").write_bytes(b"hidden")
    (tmp_path / "runs" / "link.mcap").symlink_to(tmp_path / "keys.mcap")
    (tmp_path / "runs" / "longreach.sqlite3").write_bytes(b"no recording")
    (tmp_path / "runs" / "folder").mkdir()
    async with keyed.client("admin") as client:
        answer = await client.get(f"/v1/runs/{run_id}/mcap")
        assert answer.status_code in (404, 422)
        assert b"outside" not in answer.content
        for path in (
            f"../{run_id}",
            "../keys.json",
            "../keys.mcap",
            "link.mcap",
            "/etc/passwd",
            "a/../../keys.json",
            ".",
            "a\x00b",
            "longreach.sqlite3",
            "folder",
        ):
            started = await client.post("/v1/diagnoses", json={"path": path})
            assert started.status_code == 404, path


async def test_a_slow_body_is_given_up(open_bench, monkeypatch):
    monkeypatch.setattr(guard_module, "REQUEST_BODY_TIMEOUT_S", 0.05)

    async def never():
        yield b"{"
        await asyncio.get_running_loop().create_future()

    async with open_bench.client() as client:
        answer = await client.post("/v1/jobs", content=never())
    assert (answer.status_code, answer.json()["code"]) == (408, "slow_body")


async def test_no_secret_is_in_log_database_or_answer(keyed, caplog, tmp_path):
    caplog.set_level(logging.DEBUG)
    caplog.set_level(logging.WARNING, "httpx")  # the client's own log
    async with keyed.client("operator") as client:
        lease = (await client.post("/v1/lease", json={"owner": "anna"})).json()
        held = {"Longreach-Lease": lease["lease_id"], "Longreach-Fencing": str(lease["fencing"])}
        told = [await client.post("/v1/jobs", json=PARK, headers=held)]
        told.append(await client.post("/v1/jobs", json={"kind": lease["lease_id"]}, headers=held))
        told.append(await client.put(f"/v1/lease/{lease['lease_id']}x"))
        told += [await client.get(path) for path in ("/v1/state", "/v1/audit", "/v1/lease", "/metrics")]
        told.append(await client.delete(f"/v1/lease/{lease['lease_id']}"))
    await keyed.settled()
    keyed.keeper.database.close()
    kept = b"".join(path.read_bytes() for path in (tmp_path / "runs").iterdir() if path.is_file())
    kept += (tmp_path / "keys.json").read_bytes() + caplog.text.encode() + b"".join(one.content for one in told)
    for secret in (*keyed.keys.values(), lease["lease_id"]):
        assert secret.encode() not in kept


async def test_six_wrong_keys_lock_the_address_out_but_never_a_stop(keyed):
    async with keyed.client() as client:
        for _ in range(6):
            assert (await client.get("/v1/state", headers={"Authorization": "Bearer guess"})).status_code == 401
        right = {"Authorization": f"Bearer {keyed.keys['admin']}"}
        answer = await client.get("/v1/state", headers=right)
        assert (answer.status_code, answer.json()["code"]) == (429, "locked_out")
        assert (await client.post("/v1/stop", headers=right)).status_code == 200


async def test_a_browser_logs_in_with_a_cookie_that_no_script_and_no_other_site_uses(keyed):
    async with keyed.client() as client:
        assert "password" in (await client.get("/login")).text
        assert (await client.post("/v1/session", data={"key": "wrong"})).status_code == 401
        entered = await client.post("/v1/session", data={"key": keyed.keys["operator"]})
        assert (entered.status_code, entered.headers["location"]) == (303, "../")
        cookie = entered.headers["set-cookie"]
        assert all(word in cookie for word in ("HttpOnly", "SameSite=strict", "Path=/"))
        assert keyed.keys["operator"] not in cookie
        assert (await client.get("/v1/session")).json() == {"name": "operator 1", "role": "operator"}
        assert (await client.get("/v1/state")).status_code == 200
        file = keyed.gatekeeper.keys.path
        write_keys(file, without_key(read_keys(file), "operator 1", 1.0))
        keyed.gatekeeper.keys._looked_s = float("-inf")  # a second later
        assert (await client.get("/v1/state")).status_code == 401


def a_second_later(keyed):
    keyed.gatekeeper.keys._looked_s = float("-inf")


async def test_a_key_file_that_cannot_be_read_puts_every_key_out_of_force_but_never_a_stop(keyed, caplog):
    file = keyed.gatekeeper.keys.path
    async with keyed.client() as client:
        await client.post("/v1/session", data={"key": keyed.keys["operator"]})
        file.write_text('{"keys": [')
        a_second_later(keyed)
        assert (await client.post("/v1/stop")).status_code == 200  # the first one after it: the file is read for it
        for headers in ({}, {"Authorization": f"Bearer {keyed.keys['admin']}"}):
            answer = await client.post("/v1/jobs", json=PARK, headers=headers)
            assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
            assert "cannot read its key file" in answer.json()["detail"]
            assert (await client.post("/v1/stop", headers=headers)).status_code == 200
        assert "keys.json" in (await client.get("/readyz")).text
        assert next(fault.fault_id for fault in fault_views(keyed.service)) == "keys_unreadable"
        assert caplog.text.count("no key is in force") == 1
        write_keys(file, ())  # a file again, without a key
        a_second_later(keyed)
        assert (await client.get("/v1/state")).status_code == 401
    assert "keys_unreadable" not in {fault.fault_id for fault in fault_views(keyed.service)}
    assert len(keyed.service.cell.link.stops) == 3


async def test_nothing_keeps_a_stop_away(keyed, monkeypatch):
    monkeypatch.setattr(keyed.gatekeeper.sessions, "find_session", lambda *_: 1 / 0)
    async with keyed.client(Cookie="longreach_session=anything") as client:
        assert (await client.post("/v1/stop")).status_code == 200


async def test_a_name_that_is_given_again_revives_no_cookie(keyed):
    file = keyed.gatekeeper.keys.path
    async with keyed.client() as client:
        await client.post("/v1/session", data={"key": keyed.keys["operator"]})
        kept = without_key(read_keys(file), "operator 1", 1.0)
        write_keys(file, with_key(kept, "operator 1", Role.VIEWER, new_key(), 2.0))
        a_second_later(keyed)
        assert (await client.post("/v1/jobs", json=PARK)).status_code == 401
        assert (await client.get("/v1/state")).status_code == 401


async def test_logging_out_ends_the_session(keyed):
    async with keyed.client() as client:
        await client.post("/v1/session", data={"key": keyed.keys["viewer"]})
        stolen = dict(client.cookies)
        assert (await client.delete("/v1/session")).status_code == 204
        client.cookies.clear()
        client.cookies.update(stolen)
        assert (await client.get("/v1/state")).status_code == 401


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.7.3", "server.example"])
def test_listening_beyond_this_computer_without_keys_does_not_start(tmp_path, host):
    for keys_file in (None, str(tmp_path / "none.json")):
        with pytest.raises(SettingsError, match="longreach keys add"):
            gatekeeper_of(HttpSettings(host=host, keys_file=keys_file))
    for loopback in ("127.0.0.1", "localhost", "::1", "127.3.2.1"):
        assert gatekeeper_of(HttpSettings(host=loopback)).open
    with pytest.raises(SettingsError, match="behind_proxy"):
        gatekeeper_of(HttpSettings(behind_proxy=True))


def test_a_key_file_holds_no_key_and_is_its_owners(keyed, tmp_path):
    file = tmp_path / "keys.json"
    assert file.stat().st_mode & 0o077 == 0
    assert not any(secret in file.read_text() for secret in keyed.keys.values())
    assert KeyRing(file).find_key(keyed.keys["fleet"], 1e9).name == "fleet 1"
