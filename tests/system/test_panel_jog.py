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
    pytest.mark.timeout(600),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
PLUS = "#jog-buttons button[data-jog='1']"
MOVING = "() => /running/.test(document.getElementById('link').textContent)"
RESTED = "() => !document.querySelector('#jog.running') && !document.body.classList.contains('holding')"
STALLED = "() => { const end = performance.now() + 1500; while (performance.now() < end); }"  # no answer goes out


def served(folder, settings_text=""):
    settings = folder / "server.toml"
    settings.write_text(settings_text, encoding="utf-8")
    return Stack(
        StackPorts.free(),
        seed=1,
        runs=folder / "runs",
        log_folder=folder / "logs",
        camera_rate_hz=5.0,
        settings_file=settings,
    )


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    stack = served(tmp_path_factory.mktemp("jog"))
    with stack, JobClient(stack.url) as client:
        client.wait_ready(180.0)
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


def held_down(anna, axis):
    """The plus button of an axis is down, and the machine moves."""
    anna.page.locator("#jog-axis").select_option(axis)
    anna.page.locator(f"{PLUS}:enabled").wait_for(timeout=60_000)
    box = anna.page.locator(PLUS).bounding_box()
    anna.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    anna.page.mouse.down()
    anna.page.wait_for_function(MOVING, timeout=60_000)
    anna.page.wait_for_timeout(2000)


WAYS = {
    "button up": lambda page: page.mouse.up(),
    "window lost focus": lambda page: page.evaluate("() => dispatchEvent(new Event('blur'))"),
    "STOP pressed": lambda page: page.keyboard.press("Escape"),
    "silent": lambda page: page.evaluate(STALLED),
}


@pytest.mark.parametrize("way", WAYS)
def test_it_moves_while_held_and_ends_by(way, anna, stack, tmp_path):
    before = state(stack)["q_deg"]
    held_down(anna, "joint_1")
    keep(anna.page, f"jog-{way.replace(' ', '-')}", picture_folder(tmp_path))
    assert state(stack)["job"]["state"] == "running"
    WAYS[way](anna.page)
    anna.page.wait_for_function(RESTED, timeout=20_000)
    anna.page.mouse.up()
    job = state(stack)["job"]
    assert (job["kind"], job["state"]) == ("jog", "stopped")
    assert way.split(" ")[0] in job["reason"]
    assert state(stack)["q_deg"][0] - before[0] > 0.02  # 2 s at 30 mm/s, out of the dead band


def test_a_closed_tab_stops_it(browser, stack):
    made = person(browser, stack.url, path="/?no3d")
    made.take_control()
    held_down(made, "z")
    assert state(stack)["job"]["state"] == "running"
    made.page.context.close()
    until_s = time.monotonic() + 20.0
    while (job := state(stack)["job"])["state"] in ("running", "stopping") and time.monotonic() < until_s:
        time.sleep(0.1)
    assert (job["kind"], job["state"]) == ("jog", "stopped")
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
        client.wait_ready(180.0)
        made = person(browser, stack.url, path="/?no3d")
        made.take_control()
        made.page.wait_for_function("() => /commissioning/.test(document.getElementById('jog-why').textContent)")
        assert made.page.locator(PLUS).is_disabled()
        made.page.context.close()
