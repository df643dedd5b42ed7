"""Jog in a browser on a real stack: it moves while held, and every way of letting go stops it. A click does nothing."""

import time

import httpx
import pytest
from panel_browser import CHROMIUM, FLAGS, keep, person, picture_folder

from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.slow,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
PLUS = "#jog-buttons button[data-jog='1']"
RESTED = "() => !document.querySelector('#jog.running') && !document.body.classList.contains('holding')"
PRESSES_MAX = 20
MOVED_DEG, STILL_DEG = 0.05, 0.02
SILENT = ("silent", "no hold confirmation")  # what the server and its link process say of a page that proves nothing
STALLED = "() => { const end = performance.now() + 1500; while (performance.now() < end); }"  # no answer goes out


def served(folder, settings_text=""):
    settings = folder / "server.toml"
    settings.write_text(settings_text, encoding="utf-8")
    return Stack(
        StackPorts.free(),
        seed=1,
        runs_folder=folder / "runs",
        log_folder=folder / "logs",
        camera_rate_hz=1.0,  # a jog needs no picture, and pictures take the time in which a page must prove its hold
        settings_file=settings,
    )


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    stack = served(tmp_path_factory.mktemp("jog"))
    with stack, JobClient(stack.url) as client:
        client.wait_ready(900.0)
        yield stack


@pytest.fixture(scope="module")
def browser():
    flags = [flag for flag in FLAGS if "gl" not in flag and "swiftshader" not in flag]
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=[*flags, "--disable-gpu"])
        yield opened
        opened.close()


@pytest.fixture
def anna(browser, stack):
    made = person(browser, stack.url, path="/?no3d")
    made.take_control()
    yield made
    made.page.context.close()
    assert made.faults == []


def state(stack):
    return httpx.get(f"{stack.url}/v1/state", timeout=10.0).json()


def held_down(anna, stack, axis):
    """The plus button of an axis is down, and the machine has moved. Where this computer stands still for longer than a
    hold may be unproven, the motion ends as it must: the button is pressed again."""
    page = anna.page
    page.locator("#jog-axis:enabled").select_option(axis)
    for _ in range(PRESSES_MAX):
        page.locator(f"{PLUS}:enabled").wait_for(timeout=60_000)
        before = state(stack)
        page.locator(PLUS).hover()
        page.mouse.down()
        until_s = time.monotonic() + 20.0
        while time.monotonic() < until_s:
            now = state(stack)
            job = now["job"]
            begun = job is not None and (before["job"] is None or job["job_id"] != before["job"]["job_id"])
            if begun and job["state"] not in ("running", "stopping"):
                break
            if begun and turned_deg(before["q_deg"], now["q_deg"]) > MOVED_DEG:
                return before["q_deg"]
            time.sleep(0.05)
        page.mouse.up()
        page.wait_for_function(RESTED, timeout=20_000)
    raise AssertionError(f"{PRESSES_MAX} presses, and none was held: {state(stack)['job']}")


def turned_deg(one, other):
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


def at_rest(stack):
    """The job after its end, once the boom has come to rest; nothing moves again."""
    until_s = time.monotonic() + 20.0
    while (job := state(stack)["job"])["state"] in ("running", "stopping") and time.monotonic() < until_s:
        time.sleep(0.05)
    time.sleep(1.0)
    rested = state(stack)
    time.sleep(1.5)
    later = state(stack)
    assert turned_deg(rested["q_deg"], later["q_deg"]) < STILL_DEG
    assert later["job"]["job_id"] == job["job_id"]
    assert (job["kind"], job["state"]) == ("jog", "stopped")
    return job


WAYS = {
    "button up": lambda page: page.mouse.up(),
    "window lost focus": lambda page: page.evaluate("() => dispatchEvent(new Event('blur'))"),
    "STOP pressed": lambda page: page.keyboard.press("Escape"),
    "silent": lambda page: page.evaluate(STALLED),
}


@pytest.mark.parametrize("way", WAYS)
def test_it_moves_while_held_and_ends_by(way, anna, stack):
    for _ in range(PRESSES_MAX):
        held_down(anna, stack, "joint_1")
        WAYS[way](anna.page)
        job = at_rest(stack)
        anna.page.mouse.up()
        anna.page.wait_for_function(RESTED, timeout=20_000)
        if way == "silent" or not any(text in job["reason"] for text in SILENT):
            break
    assert any(text in job["reason"] for text in (SILENT if way == "silent" else (way,)))


def test_what_it_looks_like_while_it_moves(anna, stack, tmp_path):
    """A picture holds the page up for longer than a hold may be unproven: how this press ends is not judged."""
    held_down(anna, stack, "joint_2")
    keep(anna.page, "jog-moving", picture_folder(tmp_path))
    anna.page.mouse.up()
    at_rest(stack)
    anna.page.wait_for_function(RESTED, timeout=20_000)
    assert "range -25° to 80°" in anna.text("#jog-now")
    assert "HOLD" in anna.text("#jog-why")
    for axis in ("z", "joint_2"):
        anna.page.locator("#jog-axis:enabled").select_option(axis)
        keep(anna.page, f"jog-{axis}", picture_folder(tmp_path))


def test_a_closed_tab_stops_it(browser, stack):
    for _ in range(PRESSES_MAX):
        made = person(browser, stack.url, path="/?no3d")
        made.take_control()
        held_down(made, stack, "z")
        made.page.context.close()
        job = at_rest(stack)
        if not any(text in job["reason"] for text in SILENT):
            break
    assert "page left" in job["reason"] or "socket closed" in job["reason"]


def test_a_click_and_a_program_move_nothing(anna, stack):
    before = state(stack)["job"]["job_id"]
    anna.page.locator("#jog-axis").select_option("joint_2")
    anna.page.locator(f"{PLUS}:enabled").wait_for(timeout=60_000)
    with anna.page.expect_response("**/v1/lease/*") as kept:
        pass
    lease = {name: value for name, value in kept.value.request.headers.items() if name.startswith("longreach-")}
    body = {"kind": "jog", "axis": "joint_2", "direction": 1}
    status, answer = anna.fetch("POST", "/v1/jobs", lease | {"Idempotency-Key": "a-jog-by-a-program"}, body)
    assert (status, answer["code"]) == (409, "hold_required")
    assert state(stack)["job"]["job_id"] == before


def test_a_real_machine_without_a_commissioning_does_not_jog(browser, tmp_path):
    stack = served(tmp_path, 'mode = "REAL"\n')
    with stack, JobClient(stack.url) as client:
        client.wait_ready(900.0)
        made = person(browser, stack.url, path="/?no3d")
        made.take_control()
        made.page.wait_for_function("() => /commissioning/.test(document.getElementById('jog-why').textContent)")
        assert made.page.locator(PLUS).is_disabled()
        made.page.context.close()
