"""What programs read: errors, document, events with resume, findings, runs with ranges, faults, metrics, diagnoses."""

import asyncio
import json
import os
import shutil
import sys
from contextlib import aclosing
from types import SimpleNamespace

import pytest

from server.api.events import EVENTS_KEPT_MAX, EventLog
from server.api.panel_memory import PanelMemory
from server.api.runs import GrowingFile
from server.jobs.diagnosing import Diagnoses


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/v1/nothing", 404, "unknown_path"),
        ("DELETE", "/v1/state", 405, "method_not_allowed"),
        ("POST", "/v1/lease", 422, "invalid_request"),
        ("GET", "/v1/plans/0123456789abcdef", 404, "unknown_plan"),
        ("GET", "/v1/plans/xyz", 422, "invalid_request"),
        ("GET", "/v1/runs/none/mcap", 404, "unknown_run"),
        ("GET", "/v1/diagnoses/0123456789ab", 404, "unknown_diagnosis"),
        ("GET", "/v1/camera.jpg", 503, "no_picture"),
    ],
)
async def test_every_error_is_a_problem_with_a_code_and_a_hint(open_bench, method, path, status, code):
    async with open_bench.client() as client:
        answer = await client.request(method, path)
    assert answer.headers["content-type"] == "application/problem+json"
    assert (answer.status_code, answer.json()["code"], answer.json()["status"]) == (status, code, status)
    assert answer.json()["hint"]
    assert answer.headers["x-request-id"]


async def test_an_allow_header_names_every_method_of_the_path(open_bench):
    async with open_bench.client() as client:
        for method, path, allowed in [
            ("PATCH", "/v1/jobs", "GET, POST"),
            ("POST", "/v1/lease/abc", "DELETE, PUT"),
            ("PATCH", "/v1/lease/ask", "POST"),
        ]:
            answer = await client.request(method, path)
            assert (answer.status_code, answer.headers["allow"]) == (405, allowed)


async def test_a_defect_is_500_and_tells_nothing_of_the_inside(open_bench, caplog):
    @open_bench.app.get("/v1/broken")
    async def broken():
        raise ValueError("the inside")

    async with open_bench.client() as client:
        answer = await client.get("/v1/broken")
    assert (answer.status_code, answer.json()["code"]) == (500, "internal")
    assert "the inside" not in answer.text
    assert "the inside" in caplog.text


async def test_unreadable_bodies_are_400(open_bench):
    async with open_bench.client() as client:
        for content in (b"\xff\xfe{", b"{", b'{"owner": NaN'):
            answer = await client.post("/v1/lease", content=content, headers={"Content-Type": "application/json"})
            assert (answer.status_code, answer.json()["code"]) == (400, "unreadable_body")


async def test_the_document_declares_every_refusal_as_a_problem(open_bench):
    async with open_bench.client() as client:
        document = (await client.get("/v1/openapi.json")).json()
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            where = f"{method} {path}"
            assert {"401", "403", "413", "421", "422", "429"} <= set(operation["responses"]), where
            assert operation.get("description") or operation.get("summary"), where
            problems = [answer for status, answer in operation["responses"].items() if status in ("401", "409")]
            assert all(list(answer["content"]) == ["application/problem+json"] for answer in problems), where
    assert "HTTPValidationError" not in json.dumps(document)
    assert document["paths"]["/v1/jobs"]["post"]["security"] == [{"key": []}]
    assert "security" not in document["paths"]["/v1/stop"]["post"]


async def events_of(log, last_id, count, with_state=False):
    told = []
    async with asyncio.timeout(5.0):
        async with aclosing(log.follow_events(last_id, with_state)) as story:
            async for text in story:
                told += [line for line in text.split("\n\n") if line]
                if len(told) >= count:
                    break
    return told


async def test_a_reader_goes_on_where_it_was_and_is_told_of_a_gap():
    log = EventLog("life")
    for number in range(1, 6):
        log.add("job", {"n": number})
    resumed = await events_of(log, "life-3", 3)
    assert [line.split("\n")[0] for line in resumed[1:]] == ["id: life-4", "id: life-5"]
    new = await events_of(log, "before-3", 7)
    assert "event: gap" in new[1]
    assert "restarted" in new[1]
    assert len(new) == 7
    for _ in range(EVENTS_KEPT_MAX):
        log.add("job", {})
    assert "event: gap" in (await events_of(log, "life-3", 2))[1]
    assert log.readers == 0


async def test_a_late_reader_gets_what_happens_from_then_on_and_only_the_newest_state():
    log = EventLog("life")
    log.add("job", {"n": 1})
    reading = asyncio.create_task(events_of(log, "", 3, with_state=True))
    await asyncio.sleep(0)
    for number in range(5):
        log.show_state(json.dumps({"state": number}))
    log.add("job", {"n": 2})
    told = await reading
    assert [line.split("\n")[0] for line in told[1:]] == ["id: life-2", "event: state"]
    assert '{"state": 4}' in told[2]


async def test_jobs_and_control_are_events(open_bench):
    feed = open_bench.running.event_feed
    async with open_bench.client() as client:
        await client.post("/v1/jobs", json={"kind": "park"}, headers=open_bench.control())
        await open_bench.settled()
    kinds = [text.split("event: ")[1].split("\n")[0] for _, text in feed._log._kept]
    assert kinds == ["control", "job", "job"]
    assert '"state": "failed"' in feed._log._kept[-1][1]


async def test_recordings_are_listed_and_read_in_ranges(open_bench, tmp_path):
    (tmp_path / "runs" / "20260101T000000-look-a1.mcap").write_bytes(bytes(range(200)))
    async with open_bench.client() as client:
        (run,) = (await client.get("/v1/runs")).json()
        assert (run["run_id"], run["bytes"]) == ("20260101T000000-look-a1", 200)
        url = f"/v1/runs/{run['run_id']}/mcap"
        assert (await client.get(url)).content == bytes(range(200))
        part = await client.get(url, headers={"Range": "bytes=10-19"})
        assert (part.status_code, part.content) == (206, bytes(range(10, 20)))
        assert part.headers["content-range"] == "bytes 10-19/200"
        assert (await client.get(url, headers={"Range": "bytes=900-"})).status_code == 416


async def test_metrics_are_prometheus_text(open_bench):
    async with open_bench.client() as client:
        await client.post("/v1/jobs", json={"kind": "park"}, headers=open_bench.control())
        await open_bench.settled()
        text = (await client.get("/metrics")).text
    assert 'longreach_jobs_ended_total{kind="park",state="failed"} 1.0' in text
    assert "longreach_store_ok 1.0" in text
    assert "longreach_control_held 1.0" in text
    for name in ("plc_states_received", "plc_states_lost", "plc_states_dropped", "plc_underruns"):
        assert f"# TYPE longreach_{name}_total counter" in text


async def test_alarms_and_faults_are_metrics_by_code(open_bench):
    open_bench.service.alarm_codes = lambda: frozenset({"plc_estop"})
    async with open_bench.client() as client:
        text = (await client.get("/metrics")).text
        faults = (await client.get("/v1/faults")).json()
    assert 'longreach_alarm{code="plc_estop",priority="high"} 1.0' in text
    assert 'longreach_alarm{code="disk_low",priority="medium"} 0.0' in text
    assert faults
    for fault in faults:
        assert f'longreach_fault{{fault_id="{fault["fault_id"]}",level="{fault["level"]}"}} 1.0' in text


def test_the_panels_book_says_which_alarms_are_on(open_bench):
    memory = PanelMemory(open_bench.service)
    memory.alarm_book.update({"disk_low": "", "plc_estop": ""}, 1.0)
    memory.alarm_book.update({"disk_low": ""}, 2.0)
    assert open_bench.service.alarm_codes() == {"disk_low"}


async def test_little_space_is_a_fault_a_reason_and_a_metric(open_bench, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=40_000_000))
    async with open_bench.client() as client:
        faults = {fault["fault_id"]: fault for fault in (await client.get("/v1/faults")).json()}
        ready = await client.get("/readyz")
        text = (await client.get("/metrics")).text
    assert faults["disk_low"]["level"] == "WARNING"
    assert "40 MB left (limit 1000 MB)" in faults["disk_low"]["text"]
    assert ready.status_code == 503
    assert any("40 MB left (limit 1000 MB)" in reason for reason in ready.json()["reasons"])
    assert "longreach_disk_free_bytes 4e+07" in text


async def test_a_recording_that_grows_while_it_is_sent_is_as_long_as_promised(tmp_path):
    path = tmp_path / "grows.mcap"
    path.write_bytes(bytes(200_000))
    sent = []

    async def send(message):
        sent.append(message)
        with path.open("ab") as file:  # between the head and the first bytes, and after each piece
            file.write(bytes(70_000) if len(sent) < 8 else b"")

    scope = {"type": "http", "method": "GET", "headers": [], "asgi": {"spec_version": "2.4"}}
    await GrowingFile(path)(scope, None, send)
    assert dict(sent[0]["headers"])[b"content-length"] == b"200000"
    assert sum(len(message["body"]) for message in sent[1:]) == 200_000
    assert [message["more_body"] for message in sent[1:]] == [*[True] * (len(sent) - 2), False]


async def test_head_is_answered_wherever_get_is(open_bench, tmp_path):
    (tmp_path / "runs" / "20260101T000000-look-a1.mcap").write_bytes(bytes(200))
    paths = ("/healthz", "/readyz", "/v1/state", "/metrics", "/v1/runs", "/v1/runs/20260101T000000-look-a1/mcap", "/")
    async with open_bench.client() as client:
        for path in (*paths, "/static/style.css", "/v1/runs/none/mcap"):
            got, head = await client.get(path), await client.head(path)
            assert (head.status_code, head.content) == (got.status_code, b"")
            assert head.headers["content-type"] == got.headers["content-type"]
        assert (await client.head("/healthz")).status_code == 200
        refused = await client.head("/v1/stop")
        assert (refused.status_code, refused.headers["allow"]) == (405, "POST")
        async with asyncio.timeout(5.0):  # a stream without end
            assert (await client.head("/v1/events")).status_code == 200


def command(code):
    return (sys.executable, "-c", code)


async def test_a_diagnosis_runs_beside_and_leaves_its_answer(tmp_path):
    code = (
        "import sys, os; a = sys.argv; print('half way', file=sys.stderr);"
        "open(a[a.index('--json') + 1], 'w').write('{\"verdict\": \"none\", \"nice\": %d}' % os.nice(0));"
        "open(a[a.index('--html') + 1], 'w').write('<p>')"
    )
    diagnoses = Diagnoses(tmp_path, command(code))
    one = diagnoses.start(tmp_path / "a.mcap")
    await one.task
    assert (one.state, one.last_line) == ("done", "half way")
    assert diagnoses.result(one) == {"verdict": "none", "nice": min(19, os.nice(0) + 10)}
    assert diagnoses.page(one).read_text() == "<p>"


async def test_a_diagnosis_that_fails_says_why_and_one_that_is_stopped_leaves_no_process(tmp_path):
    failing = Diagnoses(tmp_path, command("import sys; sys.exit('no such channel')"))
    one = failing.start(tmp_path / "a.mcap")
    await one.task
    assert (one.state, one.reason) == ("failed", "no such channel")
    hanging = Diagnoses(tmp_path, command("import time; time.sleep(60)"))
    two = hanging.start(tmp_path / "a.mcap")
    await asyncio.sleep(0.05)
    with pytest.raises(Exception, match=r"runs since .* wait for its end or end it"):
        hanging.start(tmp_path / "b.mcap")
    await hanging.close()
    assert two.state == "stopped"
