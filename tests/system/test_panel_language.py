"""The panel in a second language, in a real browser against a made-up state: chosen by the browser or on the page, and
nothing is cut off.

Set LONGREACH_SCREENSHOTS to a folder to keep the pictures.
"""

import json
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from panel_browser import CHROMIUM, FLAGS, SIZES, picture_folder

import web
from server.api.examples import EXAMPLES
from server.api.panel_alarm_catalogue import CATALOGUE
from server.api.panel_view import LiveView

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.timeout(600),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
STATIC = Path(web.__file__).parent / "static"
TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html", ".json": "application/json"}
VIEWS = ("history", "alarms", "joints", "story")
TABS = ("link", "vision", "calibration", "gap", "recordings", "settings")
ANSWERS = {
    "/v1/session": EXAMPLES["WhoView"],
    "/v1/lease/take": EXAMPLES["LeaseView"],
    f"/v1/lease/{EXAMPLES['LeaseView']['lease_id']}": EXAMPLES["LeaseView"],
    "/v1/identification": EXAMPLES["IdentificationView"],
    "/v1/machine/versions": EXAMPLES["VersionsView"],
    "/v1/jobs": [],
    "/v1/diagnoses": [EXAMPLES["DiagnosisView"]],
    "/v1/panel/recordings": [EXAMPLES["RecordingView"]],
    "/v1/panel/settings": [EXAMPLES["SettingRow"]],
}
#: Every socket is open; the one of the states sends this page's state ten times a second, as of now.
SOCKETS = """
class Socket extends EventTarget {
  constructor(url) {
    super();
    this.readyState = 1;
    if (new URL(url).pathname !== "/v1/live") return;
    setInterval(() => {
      const state = window.made_up;
      state.panel.mono_ms = performance.now();
      this.onmessage?.(new MessageEvent("message", { data: JSON.stringify(state) }));
    }, 100);
  }
  send() {}
  close() {}
}
Socket.OPEN = 1;
window.WebSocket = Socket;
"""
#: Texts that do not fit: wider or higher than their box, or beyond the window where nothing scrolls. The chip of the
#: newest alarm is left out: it shows two lines of any title, all of it as a tooltip and in the list.
CUT_OFF = """() => {
  const scrolls = (element) => {
    for (let at = element; at && at !== document.body; at = at.parentElement) {
      if (["auto", "scroll"].includes(getComputedStyle(at).overflowX)) return true;
    }
    return false;
  };
  const found = [];
  for (const element of document.body.querySelectorAll("*")) {
    const own = [...element.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.data.trim());
    if (!own || element.closest(".unseen, svg, option, #alarm-chip b") || !element.checkVisibility()) continue;
    const box = element.getBoundingClientRect();
    const inline = getComputedStyle(element).display === "inline";
    const hides = getComputedStyle(element).overflowY === "hidden";
    const narrow = !inline && element.scrollWidth > element.clientWidth + 1;
    const low = !inline && hides && element.scrollHeight > element.clientHeight + 1;
    const outside = (box.right > innerWidth + 1 || box.left < -1) && !scrolls(element);
    const text = element.textContent.trim().slice(0, 60);
    if (narrow || low || outside) found.push(`${element.tagName} ${element.id}: ${text}`);
  }
  return found;
}"""


def alarms():
    """Every alarm of the catalogue, some of them over or acknowledged."""
    return [
        {
            "code": kind.code, "level": kind.level, "title": kind.title, "detail": "", "cause": kind.cause,
            "remedy": kind.remedy, "clears": kind.clears, "since_unix_s": 1795348769.0,
            "ended_unix_s": 1795348779.0 if number % 3 == 1 else None,
            "acknowledged_by": "anna" if number % 3 == 2 else "",
        }
        for number, kind in enumerate(CATALOGUE.values())
    ]  # fmt: skip


def made_up(*, required, phase="armed", alarmed=True):
    """A state as the server sends it: after a look, with a plan, the control with this page."""
    panel = {
        "unix_s": 1795348800.0, "mono_ms": 0.0, "alarms": alarms() if alarmed else [], "goal": EXAMPLES["GoalView"],
        "history": [
            {"number": n, "unix_s": 1795348700.0 + n, "after": after, "status": "ok", "reason": "",
             "error": EXAMPLES["ErrorView"], "inside": n == 3, "accepted_by": "anna" if n == 3 else ""}
            for n, after in enumerate(("look", "calibrate", "execute"), start=1)
        ],
        "safety": {"estop": "not pressed", "enable": "needed to arm", "faults": []},
        "link": {
            "lateness_edges_ms": [1.0, 2.0], "lateness_counts": [90, 9, 1], "loss_pct": 0.2, "send_late_p50_ms": 0.1,
            "send_late_p99_ms": 0.5, "send_late_max_ms": 2.1, "sent": 500, "received": 499, "rejected": 0,
            "samples_dropped": 0, "buffer_ms": 2950.0, "buffer_min_ms": 120.0,
        },
        "vision": {
            "sharpness": 12.5, "exposure_age_ms": 41.0, "process_ms": 18.3, "skipped": 2, "restarts": 0,
            "video_viewers": 1, "tool": "ok", "target": "ok",
        },
        "calibration": {
            "covariance_deg2": [[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.03]],
            "weakest_axis_tcp": [0.0, 0.0, 1.0],
        },
        "scene": {"running": False, "problem": "off", "process_id": None, "scrub_frac": 1.0},
        "hold": {"required": required, "held_by": "", "limit_ms": 250.0},
        "look_moved_deg": 0.0, "look_moved_max_deg": 0.115, "look_age_max_s": 60.0, "recording": True,
        "recorder_problem": "", "disk_free_gb": 120.5,
    }  # fmt: skip
    state = EXAMPLES["StateView"] | {
        "job": None,
        "steps": {"look": "", "park": "look first", "return": "no run has begun yet"},
        "control": EXAMPLES["ControlView"]
        | {"owner": "anna", "kind": "operator", "fencing": EXAMPLES["LeaseView"]["fencing"]},
        "mode": "REAL" if required else "SIM",
        "link": EXAMPLES["StateView"]["link"] | {"phase": phase},
        "panel": panel,
    }
    return LiveView.model_validate_json(json.dumps(state)).model_dump(mode="json")


def serve(route):
    path = urlsplit(route.request.url).path
    if path.startswith("/v1/"):
        status, data = (200, ANSWERS[path]) if path in ANSWERS else (404, {"detail": path})
        return route.fulfill(status=status, content_type="application/json", body=json.dumps(data))
    file = STATIC / ("index.html" if path == "/" else path.removeprefix("/static/"))
    if not file.is_file():
        return route.fulfill(status=404, body="")
    return route.fulfill(content_type=TYPES[file.suffix], body=file.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def opened(browser):
    """Opens the page in a browser of this language, with this state."""
    contexts, faults = [], []

    def open_in(locale, state):
        context = browser.new_context(viewport={"width": 1280, "height": 800}, locale=locale)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.add_init_script(SOCKETS + f"window.made_up = {json.dumps(state)};")
        page.route("**/*", serve)
        page.goto("http://panel.test/?no3d")
        page.wait_for_function("() => /[0-9]/.test(document.querySelector('#camera b').textContent)", timeout=60_000)
        return page

    yield open_in
    for context in contexts:
        context.close()
    assert faults == []


def look_button(page):
    return page.inner_text("button[data-kind=look] b")


def test_a_german_browser_opens_the_page_in_german_and_the_page_can_choose_english(opened):
    page = opened("de-DE", made_up(required=False))
    assert page.locator("html").get_attribute("lang") == "de"
    assert look_button(page) == "1 Messen"
    assert page.inner_text("#stop b") == "STOPP (Software)"
    assert page.inner_text("#link b") == "scharf"
    assert page.inner_text("#alarm-chip b") == "SPS antwortet nicht"
    page.select_option("#language", "en")
    for _ in range(2):  # it is remembered
        page.wait_for_function("() => document.querySelector('button[data-kind=look] b')?.textContent === '1 Look'")
        assert page.inner_text("#stop b") == "Stop motion (software)"
        assert page.inner_text("#link b") == "armed"
        page.reload()


def test_a_language_that_the_page_does_not_have_gives_english(opened):
    page = opened("fr-FR", made_up(required=False))
    assert page.locator("html").get_attribute("lang") == "en"
    assert look_button(page) == "1 Look"


@pytest.mark.parametrize(
    ("name", "required", "phase", "views"),
    [("sim", False, "armed", (*VIEWS, *TABS)), ("real", True, "fault", VIEWS[:1])],
)
def test_nothing_is_cut_off_in_german(opened, tmp_path, name, required, phase, views):
    page, folder = opened("de-DE", made_up(required=required, phase=phase)), picture_folder(tmp_path)
    page.click("#control-buttons button >> text=Übernehmen")
    page.wait_for_function("() => document.getElementById('control').classList.contains('mine')")
    page.click("#more")
    found = {}
    for label, (width, height) in SIZES.items():
        page.set_viewport_size({"width": width, "height": height})
        for view in views:
            if view in TABS:
                if page.locator("#drawer").is_hidden():
                    page.click("#open-drawer")
                page.click(f"#drawer button[data-tab={view}]")
            else:
                page.click(f"#tab-{view}")
            page.wait_for_timeout(250)  # two states and a redraw
            if cut := page.evaluate(CUT_OFF):
                found[f"{view} at {label}"] = cut
            page.screenshot(path=folder / f"de-{name}-{view}-{label}.png")
        if page.locator("#drawer").is_visible():
            page.click("#close-drawer")
    assert found == {}
