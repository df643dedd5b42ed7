"""Panel, log-in and STOP behind a proxy that puts them under a path of its own; with a machine: test_panel.py."""

import re
from urllib.parse import urljoin

import httpx
import pytest
from panel_browser import CHROMIUM, FLAGS
from rest_stand import served
from sub_path_proxy import under_path
from websockets.sync.client import connect

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]
in_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's chromium")
PATH = "/site/crane-3"


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield opened
        opened.close()


@in_browser
def test_a_person_logs_in_and_stops_under_a_path(tmp_path, browser):
    with served(tmp_path) as (url, made), under_path(url, PATH) as here:
        page = browser.new_page()
        answers = []
        page.on("response", lambda answer: answers.append((answer.status, answer.url)))
        page.goto(f"{here}/")
        assert page.url == f"{here}/login"  # sent there by the server
        with page.expect_response(lambda answer: answer.url == f"{here}/v1/stop") as heard:
            page.get_by_role("button", name="Stop motion").click()
        assert heard.value.status == 200
        page.goto(f"{here}/login")
        page.fill("input[name=key]", made.keys["operator"])
        page.get_by_role("button", name="Log in").click()
        page.wait_for_url(f"{here}/")
        page.locator("#stop").click()
        page.wait_for_function("() => document.getElementById('stop').dataset.state === 'heard'", timeout=20_000)
        assert [one for one in answers if one[0] >= 400 and not one[1].endswith("/favicon.ico")] == []
        page.context.close()
        assert "stylesheet" in httpx.get(f"{url}/help/alarms/disk_low", headers=key(made)).text


def test_all_that_the_pages_name_is_there_under_a_path(tmp_path):
    """Without a browser: every address in page, log-in page and help, seen from where each of them lies."""
    with served(tmp_path) as (url, made), under_path(url, PATH) as here, httpx.Client(timeout=30.0) as client:
        sent = client.get(f"{here}/", headers={"Accept": "text/html"})
        assert (sent.status_code, urljoin(f"{here}/", sent.headers["location"])) == (303, f"{here}/login")
        forms = re.findall(r'action="([^"]+)"', client.get(f"{here}/login").text)
        assert [urljoin(f"{here}/login", form) for form in forms] == [f"{here}/v1/session", f"{here}/v1/stop"]
        entered = client.post(f"{here}/v1/session", data={"key": made.keys["operator"]})
        assert urljoin(f"{here}/v1/session", entered.headers["location"]) == f"{here}/"
        for page in (f"{here}/", f"{here}/help/alarms/disk_low"):
            named = re.findall(r'(?:href|src)="([^"]+)"', client.get(page).text)
            found = [urljoin(page, name) for name in named if not name.startswith("data:")]
            assert found
            assert [one for one in found if client.get(one).status_code != 200] == []
        cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
        socket = connect(f"{here.replace('http', 'ws')}/v1/stop", additional_headers={"Cookie": cookie})
        with socket as line:
            line.send("stop")
            assert line.recv(timeout=10.0) == "stopped"


def key(made):
    return {"Authorization": f"Bearer {made.keys['viewer']}"}
