"""Our own client against our own document: every request it makes and every field it reads is promised there; and it
gets a job done on a served stand-in though answers are lost."""

import re
import sys
import threading
from pathlib import Path

import httpx
import pytest

import longreach.fleet_client
import longreach.lease_holder
from longreach.fleet_client import JobClient, JobRefusedError
from longreach.lease_holder import ControlRefusedError, LeaseHolder

SOURCES = (longreach.fleet_client, longreach.lease_holder)
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
    monkeypatch.setattr(longreach.fleet_client, "RETRY_S", 0.01)
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
