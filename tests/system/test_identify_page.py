"""The Gap tab in a real browser against made-up answers of the server: each step from the plan to the comparison.

Set LONGREACH_SCREENSHOTS to a folder to keep a picture of each step.
"""

import json
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from panel_browser import CHROMIUM, FLAGS, picture_folder

import web
from server.api.examples import EXAMPLES

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.timeout(300),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
STATIC = Path(web.__file__).parent / "static"
TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html"}
HASH = "99c1fbdd909657cb"
PLAN = {
    "plan_hash": HASH,
    "expires_in_s": 55.0,
    "duration_s": 362.0,
    "looks": 15,
    "tcp_speed_max_mm_s": 119.6,
    "clearance_mm": 156.4,
    "caution": "",
    "cannot": ["the looks cannot tell encoder_bias of joint 1 from where object and camera are"],
    "parts": [
        {"name": "repeats", "duration_s": 44.1, "shows": ["how much the machine repeats to: the noise"], "cannot": ""},
        {"name": "slow passes", "duration_s": 35.4, "shows": ["dead band", "hysteresis"], "cannot": ""},
        {"name": "looks", "duration_s": 180.0, "shows": ["zeros", "lengths", "sag"], "cannot": ""},
    ],
}


def effect(name, joint, mm, share, status, column="stands"):
    return {
        "name": name, "joint": joint, "column": column, "tool_mm": mm, "share_frac": share, "status": status,
        "probability": 0.99 if status == "confirmed" else 0.4, "parameters": {},
    }  # fmt: skip


ANSWER = {
    "verdict": "partly",
    "why": "the confirmed effects explain 91 % of the squared miss",
    "hypotheses": [],
    "shrink": {},
    "next_experiment": {"what": None},
    "budget": {
        "sentence": "The model misses the tool by 41 mm. With the 2 confirmed effects it misses by 12 mm.",
        "miss_mm": 41.0,
        "left_mm": 12.0,
        "columns": [],
        "effects": [
            effect("gravity_sag", 2, 33.0, 0.62, "confirmed"),
            effect("link_length_error", 2, 19.0, 0.29, "confirmed"),
            effect("encoder_bias", 3, 4.0, 0.01, "doubtful"),
        ],
    },
}


class Server:
    """What the page asks for; posts change what the next answers are."""

    def __init__(self):
        self.job, self.diagnoses, self.sent = None, [], []
        self.session = {"parts_done": [], "parts_left": [], "recordings": [], "diagnosis_id": "", "next_step": ""}
        self.versions = {"in_use": "", "problem": "", "versions": [], "compared": []}

    def ended(self, kind, result, state="done", reason=""):
        event = {"number": 1, "text": f"{kind} {state}", "name": "ended"}
        self.job = {
            "job_id": "a" * 12,
            "kind": kind,
            "state": state,
            "reason": reason,
            "result": result,
            "events": [event],
        }

    def answer(self, method, path, body):
        """Status and JSON of one request."""
        self.sent.append((method, path, body))
        if method == "POST" and path == "/v1/jobs":
            self.ended(body["kind"], PLAN if body["kind"] == "plan_identify" else None, "running")
            self.job["state"] = "done" if body["kind"] == "plan_identify" else "running"
            return 202, self.job
        if method == "POST" and path == "/v1/machine/versions":
            self.versions["versions"] = [EXAMPLES["VersionView"]]
            return 201, EXAMPLES["VersionView"]
        if method == "PUT":
            self.versions["in_use"] = body["version_id"]
            return 200, self.versions
        found = {
            "/v1/identification": self.session,
            "/v1/machine/versions": self.versions,
            "/v1/jobs": [] if self.job is None else [self.job],
            f"/v1/jobs/{'a' * 12}": self.job,
            "/v1/diagnoses": self.diagnoses,
            f"/v1/diagnoses/{'d' * 12}/result": ANSWER,
            "/v1/panel/recordings": [
                {"name": "20261129T102045-identify-91f66b75d4ab.mcap", "size_mb": 157.1, "unix_s": 0}
            ],
        }.get(path)
        return (404, {"detail": path}) if found is None else (200, found)


def serve(route, server):
    path = urlsplit(route.request.url).path
    if path.startswith("/v1/"):
        body = json.loads(route.request.post_data) if route.request.post_data else None
        status, data = server.answer(route.request.method, path, body)
        return route.fulfill(status=status, content_type="application/json", body=json.dumps(data))
    if path == "/":
        page = (STATIC / "index.html").read_text(encoding="utf-8")
        gap = page[page.index('<div data-panel="gap" hidden>') : page.index('<div data-panel="recordings"')]
        script = "import{openGap}from './gap.js';import{fillTexts}from './texts.js';fillTexts(document);openGap()"
        head = '<link rel="stylesheet" href="style.css">'
        switch = '<input id="hold-switch" type="checkbox" hidden><p id="notice" hidden></p>'
        switch += '<button id="stop" hidden><b id="stop-status"></b></button><p id="stop-unheard" hidden></p>'
        shown = gap.replace("hidden>", ">", 1)
        body = f"{switch}{shown}<script type=module>{script}</script>"
        html = f"<!doctype html><html><head>{head}</head><body>{body}</body></html>"
        return route.fulfill(content_type="text/html", body=html)
    file = STATIC / path.removeprefix("/static").lstrip("/")
    if not file.is_file():
        return route.fulfill(status=404, body="")
    return route.fulfill(content_type=TYPES.get(file.suffix, "text/plain"), body=file.read_text(encoding="utf-8"))


def test_from_the_plan_to_the_comparison(tmp_path):
    folder, server = picture_folder(tmp_path), Server()
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        page = browser.new_page(viewport={"width": 760, "height": 1000})
        faults = []
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.route("**/*", lambda route: serve(route, server))
        page.goto("http://panel.test/")
        page.click("#identify-plan")
        page.locator("#identify-drive").wait_for()
        assert "6.0 min, 15 looks" in page.inner_text("#identify-plan-facts")
        page.screenshot(path=folder / "page-1-plan.png")
        server.session |= {"parts_done": [], "parts_left": ["repeats", "slow passes", "looks"]}
        page.click("#identify-drive")
        page.locator("#identify-progress").wait_for()
        assert ("POST", "/v1/jobs", {"kind": "identify", "plan_hash": HASH}) in server.sent
        server.session |= {"parts_done": ["repeats", "slow passes"], "parts_left": ["looks"]}
        page.wait_for_function("() => document.getElementById('identify-bar').value === 2")
        page.screenshot(path=folder / "page-2-drive.png")
        server.session["next_step"] = "paused after 'stopped over REST': 1 of 3 parts are left (looks); plan the rest"
        server.ended("identify", None, "stopped", "stopped over REST")
        page.locator("#identify-rest").wait_for()
        page.screenshot(path=folder / "page-3-paused.png")
        server.session |= {"parts_done": ["repeats", "slow passes", "looks"], "parts_left": [], "next_step": ""}
        done = {"state": "done", "elapsed_s": 140.0, "last_line": "", "reason": "", "recording": "identify.mcap"}
        server.diagnoses.append({"diagnosis_id": "d" * 12, **done})
        page.locator(".use-effects").wait_for()
        assert page.locator(".waterfall tr").count() == 4
        page.screenshot(path=folder / "page-4-budget.png", full_page=True)
        page.click(".use-effects")
        page.locator("#identify-off:enabled").wait_for()
        assert "Compare" not in page.inner_text("#identify-versions")
        server.versions["compared"] = [
            {"number": 1, "nominal_mm": 14.2, "in_use_mm": 2.9, "version_id": "5c1e0d7a92b4"}
        ]
        page.locator("#identify-compared").wait_for()
        page.screenshot(path=folder / "page-5-used.png", full_page=True)
        page.locator("#identify-versions input").uncheck()
        page.click("#identify-use")
        page.wait_for_timeout(300)
        assert ("PUT", "/v1/machine/in-use", {"version_id": "5c1e0d7a92b4", "on": [False]}) in server.sent
        page.click("#identify-off")
        page.locator("#identify-off:disabled").wait_for()
        assert faults == []
        browser.close()
