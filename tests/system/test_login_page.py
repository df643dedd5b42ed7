"""The page where a person without a session stands: its STOP stops, and a key opens the panel. In a real browser."""

import pytest
from panel_browser import CHROMIUM, FLAGS
from rest_stand import served

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed"),
]


@pytest.fixture
def stand(tmp_path):
    """A page in a browser, the server's address, what it is made of, and every stop that reached the engine."""
    with served(tmp_path) as (url, made), playwright.sync_playwright() as driver:
        stops, stopped = [], made.service.engine.stop

        async def stop(reason, only=None):
            stops.append(reason)
            await stopped(reason, only)

        made.service.engine.stop = stop
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser.new_page(), url, made, stops
        browser.close()


def log_in(page, url, key):
    page.goto(f"{url}/login")
    page.fill("input[name=key]", key)
    with page.expect_response(lambda answer: answer.url.endswith("/v1/session")) as heard:
        page.get_by_role("button", name="Log in").click()
    assert heard.value.status == 303
    page.wait_for_url(f"{url}/")


def test_stop_and_log_in_by_the_pages_own_forms(stand):
    page, url, made, stops = stand
    page.goto(f"{url}/login")
    with page.expect_response(lambda answer: answer.url.endswith("/v1/stop")) as heard:
        page.get_by_role("button", name="Stop motion").click()
    assert heard.value.status == 200
    assert stops == ["stopped over REST"]
    log_in(page, url, made.keys["operator"])
    assert page.locator("#stop").is_visible()


def test_stop_does_not_wait_behind_requests_that_have_no_answer(stand):
    """A browser lets six requests to one host wait for their answers; the seventh waits in the browser."""
    page, url, made, stops = stand
    log_in(page, url, made.keys["operator"])
    page.evaluate("() => { for (let k = 0; k < 8; k++) fetch('/v1/events'); }")
    page.wait_for_timeout(1000.0)
    page.locator("#stop").click()
    page.wait_for_function("() => document.getElementById('stop').dataset.state === 'heard'", timeout=10_000)
    assert "stopped in the panel" in stops
    assert "stopped over REST" not in stops
