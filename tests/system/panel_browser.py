"""A browser on the panel, for tests and for looking at it: one Chromium, any number of people."""

import os
import shutil
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
SIZES = {"1280x800": (1280, 800), "1920x1080": (1920, 1080), "390x844": (390, 844)}
CAPTURE_S, CAPTURE_WIDTH = 20.0, 800


@dataclass
class Person:
    """One browser context with one page on the panel; every request and every fault of its scripts is kept, and how
    many of its jobs the server refused."""

    page: object
    url: str
    requests: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    clicks: int = 0
    refused: int = 0

    def click(self, selector):
        """A click, counted."""
        self.page.locator(selector).first.click(timeout=30_000)
        self.clicks += 1

    def answered(self, response):
        """An answer has come; one that refuses a job is counted."""
        if response.url.endswith("/v1/jobs") and response.status >= 400:
            self.refused += 1

    def take_control(self):
        """Press Take control, and wait until the page says so."""
        self.click("#control-buttons button.primary")
        self.page.wait_for_function("() => document.getElementById('control').classList.contains('mine')")

    def step(self, kind, timeout_s=180, while_waiting=None):
        """Click a step when it may be clicked, and wait until nothing runs any more; where the server refuses it (what
        the page shows is a moment old), click again."""
        button = f"button[data-kind={kind}]:enabled"
        self.page.locator(button).wait_for(timeout=60_000)
        before, refused = self.page.evaluate(JOBS_SEEN), self.refused
        self.click(button)
        if kind in NO_JOBS:
            return
        over = f"count => ({JOBS_SEEN})() > count && !document.querySelector('.step.running')"
        for _ in range(int(timeout_s / 0.5)):
            if while_waiting is not None:
                while_waiting()
            try:
                self.page.wait_for_function(over, arg=before, timeout=500)
            except Exception as error:  # playwright's own timeout, not over yet
                if "Timeout" not in type(error).__name__:
                    raise
            else:
                return
            if self.refused > refused:
                refused = self.refused
                assert refused <= REFUSED_MAX, self.page.inner_text("#notice")
                self.click(button)
        raise AssertionError(f"{kind} has not ended within {timeout_s} s: {self.page.inner_text('#hint')}")

    def proposed(self):
        """The step the page proposes next."""
        button = self.page.locator("button.primary[data-kind]")
        button.wait_for(timeout=60_000)
        return button.get_attribute("data-kind")

    def led_to(self, kind, steps_max=8):
        """Do what the page proposes next until it proposes this step, and click it: a look too old, a calibration from
        too far away, a fault to reset, are the operator's business too. A plan that is proposed on the way to something
        else is not driven; another look is taken instead."""
        for _ in range(steps_max):
            proposed = self.proposed()
            done = "look_again" if proposed == "execute" and kind != "execute" else proposed
            self.step(done)
            if done == kind:
                return
            self.page.wait_for_timeout(700)  # until the page has read what the step has changed
        raise AssertionError(f"{steps_max} steps did not lead to {kind}: {self.page.inner_text('#hint')}")

    def text(self, selector):
        """What stands there."""
        return self.page.locator(selector).first.inner_text()

    def fetch(self, method, path, headers=None, body=None):
        """A request as a script of this page would send it: (status, JSON)."""
        return self.page.evaluate(FETCH, [method, path, headers or {}, body])


REFUSED_MAX = 4
NO_JOBS = ("accept", "reset")  # answered at once
JOBS_SEEN = "() => Number(document.body.dataset.jobs ?? 0)"
FETCH = """async ([method, path, headers, body]) => {
  const answer = await fetch(path, { method, headers: { "Content-Type": "application/json", ...headers },
                                     body: body === null ? undefined : JSON.stringify(body) });
  return [answer.status, await answer.json().catch(() => null)];
}"""


def person(browser, url, size=(1280, 800), path="/", touch=False):
    """A new person who opens the panel."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, has_touch=touch)
    page = context.new_page()
    made = Person(page, url)
    page.on("pageerror", lambda error: made.faults.append(str(error)))
    page.on("request", lambda request: made.requests.append(request.url))
    page.on("response", made.answered)
    page.on("websocket", lambda socket: made.requests.append(socket.url))
    page.goto(url + path)
    page.wait_for_function("() => document.getElementById('camera').textContent.includes('pairs/s')", timeout=90_000)
    return made


def picture_folder(tmp_path):
    """Where pictures go; LONGREACH_SCREENSHOTS keeps them."""
    folder = Path(os.environ.get("LONGREACH_SCREENSHOTS") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def keep(page, name, folder):
    """The page at the three sizes, if pictures are wanted; else only at the present one."""
    if not os.environ.get("LONGREACH_SCREENSHOTS"):
        page.screenshot(path=folder / f"{name}.png")
        return
    for label, (width, height) in SIZES.items():
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(600)
        page.screenshot(path=folder / f"{name}-{label}.png")
    page.set_viewport_size({"width": 1280, "height": 800})


class Capture:
    """Pictures on the way, put together to one animation of at most 20 s. Does nothing unless pictures are wanted."""

    def __init__(self, page):
        self._page, self._frames = page, []
        self.wanted = bool(os.environ.get("LONGREACH_SCREENSHOTS"))

    def shoot(self):
        """One frame."""
        if self.wanted:
            self._frames.append(self._page.screenshot(type="jpeg", quality=70))

    def save(self, path):
        """As animated WebP."""
        if not self.wanted or len(self._frames) < 2:
            return
        from PIL import Image

        images = [Image.open(BytesIO(data)).convert("RGB") for data in self._frames]
        size = CAPTURE_WIDTH, round(images[0].height * CAPTURE_WIDTH / images[0].width)
        small = [image.resize(size, Image.Resampling.LANCZOS) for image in images]
        duration_ms = round(1e3 * CAPTURE_S / len(small))
        small[0].save(path, save_all=True, append_images=small[1:], duration=duration_ms, loop=0, quality=42, method=4)
