"""What the page shows one second after camera, 3D view, disk, PLC or server have failed: nothing old stands uncrossed.

Set LONGREACH_SCREENSHOTS to a folder to keep the pictures.
"""

import os
import re
import signal
import subprocess

import httpx
import psutil
import pytest
from panel_browser import CHROMIUM, FLAGS, person, picture_folder

from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
CROSSED = "element => getComputedStyle(element).textDecorationLine.includes('line-through')"


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    """A small disk of its own for the recordings, where one may be mounted."""
    folder = tmp_path_factory.mktemp("disk")
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(folder)], check=False).returncode == 0
    yield folder, made
    if made:
        subprocess.run(["umount", "-l", str(folder)], check=False)


@pytest.fixture(scope="module")
def stack(tmp_path_factory, disk):
    logs = tmp_path_factory.mktemp("logs")
    ports = StackPorts.free()
    stack = Stack(
        ports, seed=1, runs_folder=disk[0], log_folder=logs, camera_rate_hz=10.0, sim_options=("--camera-faults",)
    )
    with stack, JobClient(stack.url) as client:
        client.wait_ready(180.0)
        yield stack


@pytest.fixture(scope="module")
def anna(stack):
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        made = person(browser, stack.url)
        made.take_control()
        yield made
        browser.close()
    assert made.faults == []


def after_one_second(anna, name, tmp_path):
    anna.page.wait_for_timeout(1000)
    anna.page.screenshot(path=picture_folder(tmp_path) / f"fault-{name}.png")


def crossed(anna, selector):
    found = [element.evaluate(CROSSED) for element in anna.page.locator(selector).all()]
    return bool(found) and all(found)


def test_a_frozen_camera(anna, stack, tmp_path):
    camera = f"http://127.0.0.1:{stack.ports.camera}/fault"
    assert httpx.post(camera, json={"kind": "freeze"}).status_code == 200
    after_one_second(anna, "camera-frozen", tmp_path)
    assert anna.page.locator("#veil").is_visible()
    assert crossed(anna, "#errors td.now")
    # a busy computer takes more than a second to two pictures: until then it is old, and says so
    anna.page.wait_for_function("() => /frozen/i.test(document.getElementById('veil').textContent)", timeout=30_000)
    anna.page.wait_for_function("() => /FROZEN/.test(document.getElementById('camera').textContent)", timeout=30_000)
    assert httpx.post(camera, json={"kind": "silent"}).status_code == 200
    after_one_second(anna, "camera-silent", tmp_path)
    assert anna.text("#veil").startswith("old: ")
    assert "no image" in anna.text("#camera")
    assert crossed(anna, "#errors td.now")
    httpx.post(camera, json={"kind": "none"})
    anna.page.wait_for_function("() => document.getElementById('veil').hidden", timeout=60_000)
    assert anna.page.locator("#alarm-list .alarm").count() >= 1  # latched, though it is over


def test_a_dead_3d_view(anna, tmp_path):
    anna.page.wait_for_function("() => document.getElementById('view').src.includes('run=')", timeout=240_000)
    process = anna.page.evaluate("() => new URL(document.getElementById('view').src).searchParams.get('run')")
    psutil.Process(int(process)).kill()
    after_one_second(anna, "viser-dead", tmp_path)
    assert anna.page.locator("#view").is_hidden()
    assert "is not running" in anna.text("#scene-off")
    assert anna.page.locator("#stop").is_enabled()


def test_a_full_disk(anna, stack, disk, tmp_path):
    folder, mounted = disk
    if not mounted:
        pytest.skip("no disk of its own can be mounted here")
    with (folder / "ballast").open("wb") as file:
        try:
            while True:
                file.write(bytes(65536))
                file.flush()
        except OSError:
            pass
    anna.page.wait_for_function(
        "() => /disk|recorded/i.test(document.getElementById('alarm-list').textContent)", timeout=15_000
    )
    after_one_second(anna, "disk-full", tmp_path)
    told = anna.page.locator("#alarm-list .alarm", has_text=re.compile("disk|recorded")).first.text_content()
    assert "still active" in told
    assert anna.page.locator("#stop").is_enabled()
    (folder / "ballast").unlink()


def test_a_dead_plc(anna, stack, tmp_path):
    os.killpg(stack.processes["sim"].pid, signal.SIGSTOP)
    after_one_second(anna, "plc-dead", tmp_path)
    assert "no answer" in anna.text("#link")
    assert "not known" in anna.text("#safety") or crossed(anna, "#safety b")
    assert "PLC is silent" in anna.text("button[data-kind=look]")
    assert crossed(anna, "#panel-joints td.v")
    assert anna.page.locator("#main-steps button:enabled").count() == 0
    anna.page.wait_for_timeout(3000)  # camera and 3D view are of the same process: their alarms come, too
    told = (
        anna.page.locator("#alarm-list .alarm", has_text="PLC does not answer")
        .locator("button")
        .element_handle(timeout=15_000)
    )
    anna.page.wait_for_timeout(700)
    assert told.evaluate("button => button.isConnected"), "its seconds go on, and the button stays"
    told.evaluate("button => button.click()")
    anna.page.wait_for_function(
        "() => /acknowledged/i.test(document.getElementById('alarm-list').textContent)", timeout=15_000
    )
    os.killpg(stack.processes["sim"].pid, signal.SIGCONT)


def test_a_dead_server(anna, stack, tmp_path):
    os.killpg(stack.processes["server"].pid, signal.SIGKILL)
    after_one_second(anna, "server-dead", tmp_path)
    assert "does not answer" in anna.text("#silent")
    for selector in ("#link b", "#camera b", "#camera-age", "#errors td.now", "#panel-joints td.v"):
        assert crossed(anna, selector), selector
    assert anna.text("#verdict") == "no answer from server"
    assert anna.page.locator("#main-steps button:enabled").count() == 0
