"""Identify -> read the budget -> use it -> see the difference, by clicks in a real browser on a real stack.

Set LONGREACH_SCREENSHOTS to a folder to keep a picture of each step.
"""

import httpx
import pytest
from panel_browser import CHROMIUM, FLAGS, person, picture_folder

from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.slow,
    pytest.mark.timeout(5400),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
READY_S = 1200.0
DIAGNOSED_MS = 3_600_000
CLICKS_MOST = 8


def shoot(page, name, folder):
    page.locator("#identify").screenshot(path=folder / f"{name}.png", timeout=180_000)


@pytest.fixture
def stack(tmp_path):
    settings = tmp_path / "settings.toml"
    settings.write_text("[position]\nplan_expires_s = 600\n", encoding="utf-8")  # pictures take their time
    made = Stack(
        StackPorts.free(),
        seed=1,
        runs_folder=tmp_path / "runs",
        log_folder=tmp_path / "logs",
        camera_rate_hz=5.0,
        settings_file=settings,
    )
    with made, JobClient(made.url) as client:
        client.wait_ready(READY_S)
        yield made


def test_a_machine_is_identified_and_its_effects_used_by_eight_clicks(stack, tmp_path):
    folder = picture_folder(tmp_path)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        anna = person(browser, stack.url, path="/?no3d")
        page = anna.page
        anna.take_control()
        anna.click("#open-drawer")
        anna.click("[data-tab=gap]")
        page.locator("#identify-plan:enabled").wait_for(timeout=60_000)
        page.select_option("#identify-minutes", "2")
        shoot(page, "identify-1-ask", folder)
        anna.click("#identify-plan")
        page.locator("#identify-drive:enabled").wait_for(timeout=240_000)
        assert "min" in anna.text("#identify-plan-facts")
        assert "slow passes" in anna.text("#identify-plan-facts")
        shoot(page, "identify-2-plan", folder)
        anna.click("#identify-drive")
        page.wait_for_function("() => document.getElementById('identify-bar').value >= 3", timeout=600_000)
        shoot(page, "identify-3-drive", folder)
        page.locator(".use-effects").wait_for(timeout=DIAGNOSED_MS)
        page.locator("#gap-list").screenshot(path=folder / "identify-4-budget.png", timeout=180_000)
        anna.click(".use-effects")
        page.locator("#identify-off:enabled").wait_for(timeout=60_000)
        assert anna.clicks <= CLICKS_MOST
        shoot(page, "identify-5-used", folder)
        state = httpx.get(f"{stack.url}/v1/state", timeout=10.0).json()
        versions = httpx.get(f"{stack.url}/v1/machine/versions", timeout=10.0).json()
        assert state["compensation"]["active"]
        assert versions["in_use"] == versions["versions"][0]["version_id"]
        page.locator("#identify-versions input[type=checkbox]").first.uncheck()
        page.click("#identify-use")  # the same button applies the switches of the version in use
        page.wait_for_function("() => !document.querySelector('#identify-versions input').checked", timeout=60_000)
        page.click("#identify-off")
        page.locator("#identify-off:disabled").wait_for(timeout=60_000)
        assert not httpx.get(f"{stack.url}/v1/state", timeout=10.0).json()["compensation"]["active"]
        assert anna.faults == []
        browser.close()
