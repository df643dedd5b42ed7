"""Our own client against our own document: every request it makes and every field it reads is promised there; and it
gets a job done on a served stand-in though answers are lost."""

import asyncio
import re
import signal
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

import longreach.fleet_client
from longreach.fleet_client import ControlRefusedError, JobClient, JobRefusedError, LeaseHolder
from longreach.fleet_command import stop_all

SOURCES = (longreach.fleet_client,)
CALL = re.compile(r'_http\.(get|post|put|delete)\(\s*f?"([^"]+)"')
FIELDS = {
    "LeaseView": {"lease_id", "fencing"},
    "JobView": {"state", "reason", "result", "elapsed_s", "job_id"},
    "RunView": {"run_id"},
    "JobEventView": {"elapsed_s", "text", "name", "number"},
    "Problem": {"detail", "code"},
    "ReadyView": {"reasons"},
}


def calls():
    found = {call for module in SOURCES for call in CALL.findall(Path(module.__file__).read_text(encoding="utf-8"))}
    assert len(found) >= 6
    return sorted(found)


def test_every_request_of_the_client_is_in_the_document(open_bench):
    document = open_bench.app.openapi()
    for method, path in calls():
        template = re.sub(r"\{[^}]+\}", "{lease_id}", path)
        assert method in document["paths"].get(template, {}), f"{method} {path}"
    for name, fields in FIELDS.items():
        schema = document["components"]["schemas"][name]
        assert fields <= set(schema["properties"]), name
    headers = {one["name"].lower() for one in document["paths"]["/v1/jobs"]["post"]["parameters"]}
    assert {"longreach-lease", "longreach-fencing", "idempotency-key"} <= headers


class Cut(httpx.BaseTransport):
    """Passes requests on; the answers to the first commands are lost on the way."""

    def __init__(self, below, losses):
        self.below, self.losses, self.sent = below, losses, 0

    def handle_request(self, request):
        answer = self.below.handle_request(request)
        if request.method == "POST" and request.url.path == "/v1/jobs":
            self.sent += 1
            if self.losses:
                self.losses -= 1
                answer.read()
                answer.close()
                raise httpx.ReadError("cut", request=request)
        return answer

    def close(self):
        self.below.close()


@pytest.fixture
def address(tmp_path):
    sys.path.insert(0, str(Path(__file__).parents[2] / "system"))
    from rest_stand import served

    with served(tmp_path) as (url, made):
        yield url, made


def test_a_lost_answer_is_asked_for_again_and_the_job_runs_once(address, monkeypatch):
    monkeypatch.setattr(longreach.fleet_client, "RETRY_DELAY_S", 0.01)
    url, made = address
    with JobClient(url, owner="truck 7", kind="fleet", key=made.keys["fleet"]) as client:
        cut = Cut(httpx.HTTPTransport(), losses=2)
        client._http._transport.close()
        client._http._mounts.clear()
        client._http._transport = cut
        told = []
        finished = client.run({"kind": "park"}, told.append)
        assert (finished.state, finished.reason) == ("failed", "there is no machine")
        assert [event["name"] for event in told] == ["started", "ended"]
        with pytest.raises(JobRefusedError, match="look first"):
            client.run({"kind": "preview"})
    assert cut.sent == 4
    assert [job.kind for job in made.service.engine.jobs] == ["park"]
    assert made.service.engine.leases.held is None


@pytest.mark.parametrize("ending", [KeyboardInterrupt, SystemExit, RuntimeError])
def test_whatever_ends_the_following_of_a_job_stops_the_machine(address, ending):
    url, made = address
    made.performer.hold = asyncio.Event()  # never set: the job goes on until it is stopped

    def end(_event):
        raise ending

    with JobClient(url, owner="truck 7", kind="fleet", key=made.keys["fleet"]) as client, pytest.raises(ending):
        client.run({"kind": "park"}, end)
    (job,) = made.service.engine.jobs
    assert (job.state.value, job.reason) == ("stopped", "stopped over REST")
    assert made.service.engine.leases.held is None


def test_a_stop_that_nobody_confirms_is_said(address):
    url, made = address
    made.performer.hold = asyncio.Event()  # never set: the job goes on until it is stopped

    def end(_event):
        client._http.base_url = "http://127.0.0.1:9"
        raise KeyboardInterrupt

    with JobClient(url, kind="fleet", key=made.keys["fleet"]) as client, pytest.raises(KeyboardInterrupt) as ending:
        client.run({"kind": "park"}, end)
    assert "STOP is not confirmed" in ending.value.__notes__[0]
    assert "control expires within 15 s" in ending.value.__notes__[0]


def test_a_refused_client_stops_nobody_elses_job(address):
    url, made = address
    made.performer.hold = asyncio.Event()  # never set: the job goes on until it is stopped
    key = {"Authorization": f"Bearer {made.keys['operator']}"}
    with httpx.Client(base_url=url, headers=key) as http, LeaseHolder(http, "anna", "operator") as held:
        assert http.post("/v1/jobs", json={"kind": "park"}, headers=held.headers).status_code == 202
        with JobClient(url, kind="fleet", key=made.keys["fleet"]) as client:
            with pytest.raises(JobRefusedError, match="anna"):
                client.run({"kind": "park"})
            client.stop_for_good()  # as Ctrl-C in a fleet: what another one runs goes on
        assert not made.service.engine.current.has_ended


def test_a_fleet_that_is_ended_stops_every_machine_of_its_own(address):
    url, made = address
    made.performer.hold = asyncio.Event()  # never set: the job goes on until it is stopped
    clients = [JobClient(one, kind="fleet", key=made.keys["fleet"]) for one in (url, "http://127.0.0.1:9")]
    made.service.engine.on_event(lambda _job, event: event.name == "started" and begun.set())
    begun = threading.Event()
    with ThreadPoolExecutor(2) as pool:
        running = [pool.submit(client.run, {"kind": "park"}) for client in clients[:1]]
        waiting = pool.submit(clients[1].wait_ready, 600.0)
        assert begun.wait(30.0)
        stop_all(clients)
        assert running[0].result(30.0).state == "stopped"
        with pytest.raises(JobRefusedError, match="ended before the job began"):
            waiting.result(30.0)
    for client in clients:
        client.close()


def test_one_who_has_control_is_named_to_the_next(address):
    url, made = address
    key = {"Authorization": f"Bearer {made.keys['operator']}"}
    with httpx.Client(base_url=url, headers=key) as http, LeaseHolder(http, "anna", "operator", ttl_s=1.0):
        with pytest.raises(ControlRefusedError, match=r"anna.*; wait"), LeaseHolder(http, "bert", "operator"):
            pass
        threading.Event().wait(1.5)  # kept alive from its thread, beyond its ttl
        assert http.get("/v1/lease").json()["stale"] is False


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ((200, [{"run_id": "20261127T051000-look-0b"}, {"run_id": "20261127T050000-position-0a"}]), "position-0a"),
        ((200, []), ""),
        ((503, {"detail": "closing"}), ""),
    ],
)
def test_the_run_of_a_job_is_found_where_it_was_recorded(answer, told):
    with JobClient("http://server") as client:
        client._http = httpx.Client(
            base_url="http://server",
            transport=httpx.MockTransport(lambda _request: httpx.Response(answer[0], json=answer[1])),
        )
        assert client.run_id_of("0a").endswith(told)
        assert bool(client.run_id_of("0a")) == bool(told)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_a_program_of_the_api_stops_the_machine(address, number):
    url, made = address
    made.performer.hold = asyncio.Event()  # never set: the job goes on until it is stopped
    before = signal.signal(number, signal.SIG_DFL)
    try:
        with JobClient(url, kind="fleet", key=made.keys["fleet"]) as client, pytest.raises(KeyboardInterrupt):
            client.run({"kind": "park"}, lambda _event: signal.raise_signal(number))
        assert signal.getsignal(number) is signal.SIG_DFL  # afterwards it is the program's own matter
    finally:
        signal.signal(number, before)
    (job,) = made.service.engine.jobs
    assert (job.state.value, job.reason) == ("stopped", "stopped over REST")
