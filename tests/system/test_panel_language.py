"""The panel in a second language, in a real browser: chosen by the browser or on the page, and nothing is cut off.

Set LONGREACH_SCREENSHOTS to a folder to keep the pictures.
"""

import pytest
from panel_browser import CHROMIUM, FLAGS, SIZES, picture_folder

from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test installs it")
pytestmark = [
    pytest.mark.system,
    pytest.mark.timeout(600),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer: install Debian's package chromium"),
]
READY_S = 180.0
TABS = ("link", "vision", "calibration", "gap", "recordings", "settings")
#: Texts that do not fit: wider or higher than their box, or beyond the window where nothing scrolls.
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
    if (!own || element.closest(".unseen") || element.tagName === "OPTION" || !element.checkVisibility()) continue;
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


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("language")
    stack = Stack(StackPorts.free(), seed=1, runs=folder / "runs", log_folder=folder / "logs", camera_rate_hz=10.0)
    with stack, JobClient(stack.url) as client:
        client.wait_ready(READY_S)
        yield stack


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield opened
        opened.close()


def opened(browser, stack, locale):
    """A page of a browser with this language."""
    page = browser.new_context(viewport={"width": 1280, "height": 800}, locale=locale).new_page()
    page.goto(f"{stack.url}/?no3d")
    page.wait_for_function("() => /[0-9]/.test(document.querySelector('#camera b').textContent)", timeout=90_000)
    return page


def test_a_german_browser_opens_the_page_in_german_and_the_page_can_choose_english(browser, stack):
    page = opened(browser, stack, "de-DE")
    assert page.locator("html").get_attribute("lang") == "de"
    assert page.inner_text("button[data-kind=look] b") == "1 Messen"
    assert page.inner_text("#stop b") == "Bewegung stoppen (Software)"
    page.select_option("#language", "en")
    page.wait_for_function("() => document.querySelector('button[data-kind=look] b')?.textContent === '1 Look'")
    assert page.inner_text("#stop b") == "Stop motion (software)"
    page.reload()
    page.wait_for_function("() => document.querySelector('button[data-kind=look] b')?.textContent === '1 Look'")
    page.context.close()


def test_a_language_that_the_page_does_not_have_gives_english(browser, stack):
    page = opened(browser, stack, "fr-FR")
    assert page.locator("html").get_attribute("lang") == "en"
    assert page.inner_text("button[data-kind=look] b") == "1 Look"
    page.context.close()


def test_nothing_is_cut_off_in_german(browser, stack, tmp_path):
    page, folder = opened(browser, stack, "de-DE"), picture_folder(tmp_path)
    page.click("#control-buttons button.primary")
    page.wait_for_function("() => document.getElementById('control').classList.contains('mine')")
    page.click("button[data-kind=look]:enabled")
    page.wait_for_function("() => document.getElementById('history-body').children.length > 0", timeout=120_000)
    page.click("#more")
    found = {}
    for label, (width, height) in SIZES.items():
        page.set_viewport_size({"width": width, "height": height})
        for view in ("page", "alarms", *TABS):
            if view == "page":
                page.click("#tab-history")
            elif view == "alarms":
                page.click("#tab-alarms")
            else:
                if page.locator("#drawer").is_hidden():
                    page.click("#open-drawer")
                page.click(f"#drawer button[data-tab={view}]")
            page.wait_for_timeout(500)
            if cut := page.evaluate(CUT_OFF):
                found[f"{view} at {label}"] = cut
            page.screenshot(path=folder / f"de-{view}-{label}.png", full_page=view in ("page", "alarms"))
        page.click("#close-drawer")
    page.context.close()
    assert found == {}
