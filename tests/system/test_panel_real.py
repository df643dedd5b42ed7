"""REAL mode in a browser, with the simulated PLC as if it was steel: what moves is held, by mouse, touch or key.

Set LONGREACH_SCREENSHOTS to a folder to keep the pictures.
"""

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
HELD_MS = 2500
MOVING = "() => /running/.test(document.getElementById('link').textContent)"
RESTED = "() => !document.querySelector('.step.running') && !document.body.classList.contains('holding')"


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("real")
    settings = folder / "server.toml"
    settings.write_text('mode = "REAL"\n', encoding="utf-8")
    ports = StackPorts.free()
    stack = Stack(
        ports,
        seed=1,
        runs_folder=folder / "runs",
        log_folder=folder / "logs",
        camera_rate_hz=5.0,
        settings_file=settings,
    )
    with stack, JobClient(stack.url) as client:
        client.wait_ready(180.0)
        client.run({"kind": "look"})  # nobody parks before having looked for a wall
        yield stack


@pytest.fixture(scope="module")
def anna(stack):
    flags = [flag for flag in FLAGS if "gl" not in flag and "swiftshader" not in flag]
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=[*flags, "--disable-gpu"])
        made = person(browser, stack.url, path="/?no3d", touch=True)
        made.take_control()
        yield made
        browser.close()
    assert made.faults == []


def job(stack):
    return httpx.get(f"{stack.url}/v1/state", timeout=10.0).json()["job"]


def middle(anna, kind):
    """Where that button is, once it may be pressed."""
    button = anna.page.locator(f"button[data-kind={kind}]:enabled")
    button.wait_for(timeout=60_000)
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def let_go_and_check(anna, stack, kind, let_go):
    """It moved, let go: it ramped down because the button came up, or because its way was done."""
    anna.page.wait_for_function(MOVING, timeout=60_000)
    anna.page.wait_for_timeout(HELD_MS)
    assert job(stack)["state"] == "running"
    let_go()
    anna.page.wait_for_function(RESTED, timeout=20_000)
    ended = job(stack)
    assert (ended["kind"], ended["state"]) == (kind, "stopped")
    assert "button up" in ended["reason"]


def test_the_page_says_that_steel_moves_and_a_click_over_rest_is_refused(anna, stack, tmp_path):
    page = anna.page
    assert anna.text("#mode") == "REAL"
    told = page.locator("#alarm-list").text_content()
    assert "the PLC says that it drives a simulation" in told
    assert page.locator("#hold-switch").is_disabled()
    assert "HOLD" in anna.text("button[data-kind=retract]")
    with page.expect_response("**/v1/lease/*") as kept:  # the page's own secret, as a script beside it could take it
        pass
    lease = {name: value for name, value in kept.value.request.headers.items() if name.startswith("longreach-")}
    status, told = anna.fetch("POST", "/v1/jobs", lease | {"Idempotency-Key": "by-a-click"}, {"kind": "park"})
    assert (status, told["code"]) == (409, "hold_required")
    keep(page, "real-0", picture_folder(tmp_path))


def test_held_by_the_mouse(anna, stack, tmp_path):
    page = anna.page
    page.locator("#more").click()
    page.locator("#retract-mm").fill("1000")
    page.mouse.move(*middle(anna, "retract"))
    page.mouse.down()
    let_go_and_check(anna, stack, "retract", page.mouse.up)
    keep(page, "real-1-mouse", picture_folder(tmp_path))


def test_held_by_a_key(anna, stack):
    middle(anna, "park")
    anna.page.locator("button[data-kind=park]").focus()
    anna.page.keyboard.down("Space")
    let_go_and_check(anna, stack, "park", lambda: anna.page.keyboard.up("Space"))


def test_held_by_a_finger_that_wanders(anna, stack):
    page = anna.page
    touch = page.context.new_cdp_session(page)

    def send(kind, *points):
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]})

    x, y = middle(anna, "park")
    send("touchStart", (x, y))
    page.wait_for_function(MOVING, timeout=60_000)
    for step in range(6):
        send("touchMove", (x + 2 * step, y + 5 * step))
    let_go_and_check(anna, stack, "park", lambda: send("touchEnd"))
