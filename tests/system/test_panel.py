"""The panel in a real browser, on a real stack: Look, Orient, Calibrate, Preview, Move by clicks, and STOP.

Set LONGREACH_SCREENSHOTS to a folder to keep the pictures (the README's are made this way).
"""

import os
import shutil
import time
from pathlib import Path

import httpx
import pytest

from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.system,
    pytest.mark.timeout(420),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
READY_S = 180.0


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("panel")
    stack = Stack(StackPorts.free(), seed=1, runs=folder / "runs", log_folder=folder / "logs", camera_rate_hz=10.0)
    with stack, JobClient(stack.url) as client:
        client.wait_ready(READY_S)
        yield stack


@pytest.fixture
def page(stack):
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        opened = browser.new_page(viewport={"width": 1440, "height": 1000})
        faults = []
        opened.on("pageerror", lambda error: faults.append(str(error)))
        opened.goto(stack.url)
        yield opened
        browser.close()
        assert faults == []


def keep(page, name, tmp_path):
    folder = Path(os.environ.get("LONGREACH_SCREENSHOTS") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=folder / f"{name}.png")


def click_and_finish(page, kind, timeout_s):
    """Click a step and wait for the end of its job, as the page tells it."""
    page.locator(f"button[data-kind={kind}]:enabled").first.click(timeout=20_000)
    done = "kind => document.getElementById('job').textContent.startsWith(kind + ' done')"
    page.wait_for_function(done, arg=kind, timeout=timeout_s * 1e3)


def look_error(stack):
    with JobClient(stack.url) as client:
        return client.state()["look"]["error"]


def test_an_operator_positions_the_tool_by_clicks(page, stack, tmp_path):
    page.wait_for_function("() => document.getElementById('camera').textContent.includes('pairs/s')", timeout=60_000)
    click_and_finish(page, "look", 60)
    page.wait_for_timeout(1500)
    keep(page, "panel-before", tmp_path)
    before = look_error(stack)
    click_and_finish(page, "orient", 120)
    click_and_finish(page, "calibrate", 120)
    click_and_finish(page, "look", 60)
    click_and_finish(page, "preview", 30)
    page.wait_for_timeout(1500)
    keep(page, "panel-preview", tmp_path)
    click_and_finish(page, "execute", 120)
    page.wait_for_timeout(1000)
    keep(page, "panel-after", tmp_path)
    after = look_error(stack)
    assert before["distance_mm"] > 300.0
    assert after["distance_mm"] < 40.0  # one move; the loop goes on from here
    assert page.locator("#moves tbody tr").count() >= 1


def test_stop_is_always_there_and_ends_a_moving_job(page, stack):
    with httpx.Client(base_url=stack.url) as client:
        job = client.post("/v1/jobs", json={"kind": "return"}).json()  # half a metre, back to the start
        deadline = time.monotonic() + 60.0
        while client.get("/v1/state").json()["link"]["phase"] != "running":
            assert time.monotonic() < deadline
            page.wait_for_timeout(100)
        page.locator("#stop").click(force=True)  # no waiting for a still picture: an operator does not wait either
        stopped = "() => /return stopped/.test(document.getElementById('job').textContent)"
        page.wait_for_function(stopped, timeout=20_000)
        ended = client.get(f"/v1/jobs/{job['job_id']}").json()
        assert ended["state"] == "stopped"
        assert client.get("/v1/state").json()["link"]["phase"] == "armed"


def test_a_foreign_page_cannot_open_the_live_channel(stack):
    import websockets.sync.client as client
    from websockets.exceptions import InvalidStatus

    address = stack.url.replace("http", "ws") + "/v1/live"
    with pytest.raises(InvalidStatus):
        client.connect(address, additional_headers={"Origin": "http://evil.example"})
    with client.connect(address) as ours:
        assert '"machine":"hiab033"' in ours.recv(timeout=5.0)
