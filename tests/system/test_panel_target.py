"""The panel in a real browser before bare rock: a click measures a place, one more uses it, and a look sees it."""

import httpx
import pytest
from panel_browser import CHROMIUM, FLAGS, keep, person, picture_folder

from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.timeout(900),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
READY_S = 300.0
SLOW_MS = 60_000
ANSWERED = (
    "() => /known|Not measured/.test(document.getElementById('target-line').textContent)"
    " || !document.getElementById('notice').hidden"
)


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("target")
    ports, options = StackPorts.free(), ("--bare-rock",)
    stack = Stack(
        ports, seed=1, runs_folder=folder / "runs", log_folder=folder / "logs", camera_rate_hz=5.0, sim_options=options
    )
    with stack, JobClient(stack.url) as client:
        client.wait_ready(READY_S)
        yield stack


@pytest.fixture(scope="module")
def anna(stack):
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        made = person(browser, stack.url, path="/?no3d")
        yield made
        made.page.context.close()
        browser.close()
        assert made.faults == []


def test_a_click_measures_a_place_and_the_next_uses_it(anna, stack, tmp_path):
    page, folder = anna.page, picture_folder(tmp_path)
    page.wait_for_function("() => Number(document.getElementById('picture').dataset.drawn) > 2", timeout=SLOW_MS)
    anna.take_control()
    page.click("#target-choose")
    box = page.locator("#picture").bounding_box()
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.4 * box["height"])
    page.wait_for_function(ANSWERED, timeout=SLOW_MS)
    keep(page, "target-0-answered", folder)
    assert page.inner_text("#notice") == ""
    assert page.locator("#target-use").is_visible(), page.inner_text("#target-line")
    candidate = httpx.get(f"{stack.url}/v1/target", timeout=30.0).json()["candidate"]
    assert candidate["status"] == "ok"
    assert candidate["u_px"] == pytest.approx(640.0, abs=3.0)
    assert candidate["v_px"] == pytest.approx(288.0, abs=3.0)
    page.wait_for_timeout(1500)
    keep(page, "target-1-measured", folder)
    page.click("#target-use")
    page.wait_for_function("() => document.getElementById('target-line').textContent.includes('chosen place')")
    assert httpx.get(f"{stack.url}/v1/target", timeout=30.0).json()["target"]["target_id"] == candidate["target_id"]
    page.wait_for_timeout(3000)
    keep(page, "target-2-used", folder)
    page.click("#target-clear")
    page.wait_for_function("() => document.getElementById('target-line').textContent.includes('markers')")
    assert httpx.get(f"{stack.url}/v1/target", timeout=30.0).json()["target"] is None
