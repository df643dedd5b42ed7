"""The panel in a real browser, on a real stack: a whole positioning run by clicks, STOP, two people, what it asks for.

The tests share one machine and go from one to the next: run the whole file, in its order (a single test may miss what
an earlier one has made, such as a calibration or a recording).

Set LONGREACH_SCREENSHOTS to a folder to keep the pictures and the capture (the README's are made this way).
"""

import json
import os
from urllib.parse import urlsplit

import httpx
import pytest
from panel_browser import CHROMIUM, FLAGS, Capture, keep, person, picture_folder
from sub_path_proxy import under_path

from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.timeout(600),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
READY_S = 180.0
PATH = "/site/crane-3"


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("panel")
    stack = Stack(
        StackPorts.free(), seed=1, runs_folder=folder / "runs", log_folder=folder / "logs", camera_rate_hz=10.0
    )
    with stack, JobClient(stack.url) as client:
        client.wait_ready(READY_S)
        yield stack


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield opened
        opened.close()


PLAIN = "/" if os.environ.get("LONGREACH_SCREENSHOTS") else "/?no3d"  # 3D without a graphics card takes a whole core


@pytest.fixture
def anna(browser, stack):
    made = person(browser, stack.url, path=PLAIN)
    yield made
    made.page.context.close()
    assert made.faults == []


@pytest.fixture
def viewer(browser, stack):
    """One who has the 3D view open."""
    made = person(browser, stack.url)
    made.page.wait_for_function("() => document.getElementById('view').src.includes('run=')", timeout=240_000)
    yield made
    made.page.context.close()
    assert made.faults == []


@pytest.fixture
def bert(browser, stack):
    made = person(browser, stack.url, path="/?no3d")
    yield made
    made.page.context.close()
    assert made.faults == []


def state(stack):
    return httpx.get(f"{stack.url}/v1/state", timeout=10.0).json()


def moved_deg(stack, before):
    return max(abs(a - b) for a, b in zip(state(stack)["q_ref_deg"], before["q_ref_deg"], strict=True))


def seen_after_a_move(now):
    return bool(now["moves"]) and now["look"]["error"] is not None


def primaries(page):
    return page.locator("button.primary").count()


def test_an_operator_positions_the_tool_by_clicks(anna, stack, tmp_path):
    """From opening the page to the accepted result: at most 8 clicks, never two next steps, no dialog.

    A computer too slow for its own machine makes looks too old, and steps fail or are refused: such a step the page
    proposes again, and only such a click is not counted.
    """
    page, folder, capture = anna.page, picture_folder(tmp_path), Capture(anna.page)
    page.on("dialog", lambda dialog: pytest.fail(f"a dialog: {dialog.message}"))
    keep(page, "0-open", folder)
    assert primaries(page) == 1  # Take control
    anna.take_control()
    before, again, failures = None, 0, []

    def clicked(kind, **options):
        anna.step(kind, **options)
        page.wait_for_timeout(700)
        now = state(stack)
        if now["job"]["state"] == "failed" or now["look"]["error"] is None:
            failures.append(f"{kind}: {now['job']['reason']}; look: {now['look']['reason']}")

    def clicked_again(proposed):
        nonlocal again
        again += 1
        assert proposed.startswith("look") or failures, anna.text("#hint")
        assert again <= 4, failures
        clicked(proposed)

    for number, kind in enumerate(("look", "orient", "calibrate", "look_again", "preview", "execute"), start=1):
        while (proposed := anna.proposed()) != kind:
            clicked_again(proposed)
        assert primaries(page) == 1
        clicked(kind, while_waiting=capture.shoot)
        keep(page, f"{number}-{kind}", folder)
        before = before or state(stack)["look"]["error"]
    while not seen_after_a_move(state(stack)):
        clicked_again(anna.proposed())
    after = state(stack)["look"]["error"]
    assert before["distance_mm"] > 300.0
    assert after["distance_mm"] < 40.0  # one move; the loop goes on from here
    if page.locator("button[data-kind=accept]:enabled").count():
        anna.step("accept")
        page.wait_for_function("() => /accepted by/.test(document.getElementById('history-body').textContent)")
        capture.shoot()
    keep(page, "7-accept", folder)
    capture.save(folder / "panel.webp")
    assert anna.clicks - again - anna.refused <= 8
    assert page.locator("#history-body tr").count() >= 4


def test_every_view_of_the_drawer_opens_and_a_run_is_replayed(anna, tmp_path):
    page, folder = anna.page, picture_folder(tmp_path)
    page.locator("#open-drawer").click()
    for tab in ("link", "vision", "calibration", "gap", "recordings", "settings"):
        page.locator(f"[data-tab={tab}]").click()
        page.wait_for_timeout(400)
        keep(page, f"drawer-{tab}", folder)
    assert page.locator("#settings-body tr").count() > 20
    page.locator("[data-tab=recordings]").click()
    page.locator("#recordings-body tr").last.get_by_role("button").click()  # the oldest one is finished
    page.wait_for_function(
        "() => /of [0-9.]+ s/.test(document.getElementById('replay-at').textContent)", timeout=60_000
    )
    page.locator("#replay-slider").fill("0.5")
    page.wait_for_function("() => document.getElementById('replay-picture').naturalWidth > 0", timeout=20_000)
    assert "°" in anna.text("#replay-joints")
    keep(page, "drawer-replay", folder)


def test_the_second_person_cannot_execute_but_can_stop(anna, bert, stack):
    anna.take_control()
    page = bert.page
    page.wait_for_function("() => /has control/.test(document.getElementById('holder').textContent)")
    assert page.locator("#main-steps button:enabled").count() == 0
    assert "has control" in bert.text("#main-steps button small")  # says why, in words
    assert bert.fetch("POST", "/v1/jobs", body={"kind": "return"})[0] == 403
    anna.page.locator("button[data-kind=return]:enabled").click()
    page.wait_for_function("() => /running/.test(document.getElementById('link').textContent)", timeout=60_000)
    page.locator("#stop").click(force=True)  # no waiting for a still picture: an operator does not wait either
    anna.page.wait_for_function("() => !document.querySelector('.step.running')", timeout=20_000)
    ended = state(stack)
    assert (ended["job"]["kind"], ended["job"]["state"]) == ("return", "stopped")
    assert ended["link"]["phase"] == "armed"


def test_control_is_asked_for_and_handed_over(anna, bert):
    anna.take_control()
    bert.page.get_by_role("button", name="Request control", exact=True).click()
    anna.page.get_by_role("button", name="Hand over to").click(timeout=20_000)
    bert.page.locator("#control-buttons button.primary").click(timeout=20_000)
    bert.page.wait_for_function("() => document.getElementById('control').classList.contains('mine')")
    anna.page.wait_for_function("() => !document.getElementById('control').classList.contains('mine')")


def test_a_stale_tab_cannot_fire_a_plan_nor_can_a_replayed_request(anna, bert, stack):
    """Anna previews; Bert takes over and previews anew. Anna's request, her old plan under Bert's control, and Bert's
    own request sent again: none of them moves anything."""
    sent = []
    for who in (anna, bert):
        who.page.on("request", lambda one: sent.append(one) if one.url.endswith("/v1/jobs") else None)
    anna.take_control()
    anna.step("look")
    anna.led_to("preview")
    old_hash = state(stack)["plan"]["plan_hash"]
    old_headers = headers_of(sent[-1])
    bert.page.get_by_role("button", name="Take over", exact=True).click()
    bert.page.wait_for_function("() => document.getElementById('control').classList.contains('mine')")
    bert.step("look")
    bert.led_to("preview")
    before = state(stack)
    assert before["plan"]["plan_hash"] != old_hash
    mine = headers_of(sent[-1])
    status, told = anna.fetch("POST", "/v1/jobs", old_headers, {"kind": "execute", "plan_hash": old_hash})
    assert (status, told["code"]) == (409, "lease_lost")
    status, told = bert.fetch("POST", "/v1/jobs", mine, {"kind": "execute", "plan_hash": old_hash})
    assert (status, told["code"]) == (409, "plan_refused")
    assert moved_deg(stack, before) < 1e-6
    bert.step("execute")
    fired = sent[-1]
    rested = state(stack)
    assert json.loads(fired.post_data)["kind"] == "execute"
    again = headers_of(fired) | {"Idempotency-Key": fired.headers["idempotency-key"]}
    status, told = bert.fetch("POST", "/v1/jobs", again, json.loads(fired.post_data))
    assert (status, told["job_id"]) == (202, rested["job"]["job_id"])  # the first answer again, not another job
    status, told = bert.fetch("POST", "/v1/jobs", mine, json.loads(fired.post_data))
    assert (status, told["code"]) == (409, "plan_refused")
    assert moved_deg(stack, rested) < 1e-6


def headers_of(request):
    return {name: value for name, value in request.headers.items() if name.startswith("longreach-")}


def test_held_in_sim_it_moves_only_while_held(anna, stack):
    """The switch makes SIM behave like REAL: the key goes down, it moves; the key comes up, it ramps down."""
    page = anna.page
    anna.take_control()
    page.locator("#more").click()
    page.locator("#hold-switch").check()
    button = page.locator("button[data-kind=retract]:enabled")
    assert "HOLD: " in button.inner_text()
    button.focus()
    page.keyboard.down("Space")
    page.wait_for_function("() => /running/.test(document.getElementById('link').textContent)", timeout=60_000)
    page.keyboard.up("Space")
    page.wait_for_function("() => !document.querySelector('.step.running')", timeout=20_000)
    ended = state(stack)["job"]
    assert ended["state"] == "stopped"
    assert "button up" in ended["reason"]


def test_a_dead_3d_view_takes_nothing_along(viewer, stack):
    import psutil

    page = viewer.page
    viewer.take_control()
    process = int(page.evaluate("() => new URL(document.getElementById('view').src).searchParams.get('run')"))
    psutil.Process(process).kill()
    page.wait_for_function("() => document.getElementById('view').hidden", timeout=10_000)
    assert "3D view is not running" in viewer.text("#scene-off")
    with page.expect_response("**/v1/stop") as answered:
        page.locator("#stop").click()
    assert answered.value.status == 200
    page.wait_for_function(f"() => /run=(?!{process})/.test(document.getElementById('view').src)", timeout=60_000)


def test_states_pictures_commands_and_the_3d_view_come_through_under_a_path(browser, stack):
    """Behind a proxy that puts all of it under a path of its own."""
    with under_path(stack.url, PATH) as here:
        made = person(browser, here)  # waits for the camera's rate: states came
        page = made.page
        page.wait_for_function("() => Number(document.getElementById('picture').dataset.drawn) > 2", timeout=60_000)
        made.take_control()
        with page.expect_response(lambda answer: answer.url == f"{here}/v1/stop") as heard:
            page.locator("#stop").dispatch_event("pointerdown")
        assert heard.value.status == 200
        page.wait_for_function("() => document.getElementById('view').src.includes('run=')", timeout=240_000)
        assert page.evaluate("() => document.getElementById('view').src").startswith(f"{here}/view/?")
        page.frame_locator("#view").locator("canvas").first.wait_for(timeout=120_000)
        page.wait_for_timeout(1000.0)
        own = [url for url in made.requests if not url.startswith(("blob:", "data:"))]
        outside = [url for url in own if PATH not in url]
        assert outside == []
        assert any(url.startswith("ws") and url.rstrip("/").endswith("/view") for url in own)
        assert {f"{here}/v1/{name}".replace("http", "ws", 1) for name in ("live", "video", "stop")} <= set(own)
        with page.expect_response(lambda answer: answer.url == f"{here}/v1/stop") as heard:  # Esc from inside it
            page.frame_locator("#view").locator("canvas").first.click(timeout=60_000, force=True)
            page.keyboard.press("Escape")
        assert heard.value.status == 200
        page.context.close()
        assert made.faults == []


def test_stop_goes_out_at_the_touch_and_says_whether_it_was_heard(anna):
    """Neither way is heard at first, the request is later; the open socket alone: test_login_page.py."""
    page = anna.page.context.new_page()
    page.route_web_socket("**/v1/stop", lambda socket: socket.close())
    page.route("**/v1/stop", lambda route: route.fulfill(status=503, json={"detail": "the link did not confirm"}))
    page.goto(anna.url + "/?no3d")
    page.locator("#stop").hover(force=True)
    page.mouse.down()
    page.wait_for_function("() => document.getElementById('stop-status').textContent === 'NOT CONFIRMED'")
    assert "emergency stop" in page.locator("#stop-unheard").inner_text()
    page.mouse.up()
    page.unroute("**/v1/stop")
    page.keyboard.press("Escape")
    page.wait_for_function("() => document.getElementById('stop-status').textContent === 'STOP received'")
    assert page.locator("#stop-unheard").is_hidden()
    page.close()


def test_esc_stops_from_inside_the_3d_view(viewer):
    page = viewer.page
    page.frame_locator("#view").locator("canvas").first.click(timeout=60_000, force=True)
    with page.expect_response("**/v1/stop") as answered:
        page.keyboard.press("Escape")
    assert answered.value.status == 200
    page.wait_for_function("() => document.getElementById('stop-status').textContent === 'STOP received'")


def test_a_double_click_takes_control_and_keeps_it(anna):
    page = anna.page
    page.locator("#control-buttons button.primary").dblclick()
    page.wait_for_function("() => document.getElementById('control').classList.contains('mine')")
    page.wait_for_timeout(500)
    assert "You have control" in anna.text("#holder")


def test_an_ended_session_is_told_as_that_and_not_as_a_dead_server(anna):
    page = anna.page.context.new_page()
    page.route_web_socket("**/v1/live", lambda socket: socket.close())
    page.route("**/v1/session", lambda route: route.fulfill(status=401, json={"code": "unauthorized"}))
    page.goto(anna.url + "/?no3d")
    page.locator("#logged-out a[href='login']").wait_for(timeout=20_000)
    assert page.locator("#silent").is_hidden()


def test_nothing_is_asked_of_another_host_and_no_inline_code_is_allowed(viewer, stack):
    viewer.page.wait_for_timeout(3000)
    ours = urlsplit(stack.url).netloc
    hosts = {urlsplit(url).netloc for url in viewer.requests if urlsplit(url).scheme not in ("data", "blob")}
    assert hosts == {ours}
    policy = httpx.get(stack.url).headers["content-security-policy"]
    assert "unsafe" not in policy
    assert "default-src 'none'" in policy
    assert viewer.page.frames[1].evaluate("() => self.crossOriginIsolated")  # the 3D view cannot hold up the page


def test_axe_finds_no_serious_violation(anna, tmp_path):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    page = anna.page
    for tab in ("history", "alarms", "joints", "story"):
        page.locator(f"#tab-{tab}").click()
        found = axe.Axe().run(page, context={"exclude": [["iframe"]]}).response["violations"]
        assert grave(found) == []
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        page.locator("#open-drawer").click()
        found = axe.Axe().run(page, context={"exclude": [["iframe"]]}).response["violations"]
        assert grave(found) == []
        page.locator("#close-drawer").click()
        keep(page, f"scheme-{scheme}", picture_folder(tmp_path))


def grave(violations):
    return [
        (one["id"], node["target"], node["failureSummary"][:200])
        for one in violations
        if one["impact"] in ("serious", "critical")
        for node in one["nodes"][:3]
    ]


def test_a_foreign_page_cannot_open_the_sockets(stack):
    import websockets.sync.client as client
    from websockets.exceptions import InvalidStatus

    address = stack.url.replace("http", "ws")
    for path in ("/v1/live", "/v1/video", "/v1/hold", "/view"):
        with pytest.raises(InvalidStatus):
            client.connect(address + path, additional_headers={"Origin": "http://evil.example"})
    with client.connect(address + "/v1/live") as ours:
        assert '"machine":"hiab033"' in ours.recv(timeout=5.0)
