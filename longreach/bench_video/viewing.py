"""Viewers in a real browser on a live stack, and the time code read back from what the browser composed."""

import base64
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import httpx
import numpy as np

from sim_plc.camera.time_code import read

FLAGS = ("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-gpu")
ALONE = """() => { const style = new CSSStyleSheet();
  style.replaceSync('header, #notices, footer, .column:last-child, .scene, h2 { display: none !important } '
    + 'main { display: block !important; padding: 0 !important } '
    + 'section { padding: 0 !important; border: 0 !important }');
  document.adoptedStyleSheets = [style]; }"""
DRAWN = "() => Number(document.getElementById('picture').dataset.drawn ?? 0)"


@dataclass(frozen=True, slots=True)
class Watched:
    """With so many viewers for so long: vision's rate, and what each viewer drew."""

    viewers: int
    seconds: float
    vision_hz: float
    viewer_hz: tuple[float, ...]


def opened(browser: Any, url: str) -> Any:
    """A viewer: the page without its 3D view, which needs a graphics card that a test computer lacks."""
    page = browser.new_context(viewport={"width": 1280, "height": 720}).new_page()
    page.goto(f"{url}/?no3d")
    page.wait_for_function(f"() => ({DRAWN})() > 0", timeout=60_000)
    return page


def watch(url: str, pages: list[Any], seconds: float) -> Watched:
    """Count for a while what each viewer draws."""
    before, started = [page.evaluate(DRAWN) for page in pages], time.monotonic()
    vision_hz = _pairs_seen(url, seconds)
    drawn = [page.evaluate(DRAWN) - earlier for page, earlier in zip(pages, before, strict=True)]
    took_s = time.monotonic() - started
    return Watched(len(pages), round(took_s, 1), vision_hz, tuple(round(count / took_s, 2) for count in drawn))


def _pairs_seen(url: str, seconds: float) -> float:
    """Vision's own rate, averaged over the time [Hz]."""
    rates: list[float] = []
    end = time.monotonic() + seconds
    with httpx.Client(base_url=url, timeout=10.0) as client:
        while time.monotonic() < end:
            rates.append(float(client.get("/v1/state").json()["camera"]["fps"]))
            time.sleep(0.5)
    return float(np.mean(rates))


def latencies(page: Any, seconds: float, wall_minus_mono_ns: Callable[[], int]) -> list[float]:
    """From exposure to the frame that the browser composed [ms]: its own stamp against the code in its pixels."""
    page.evaluate(ALONE)
    session = page.context.new_cdp_session(page)
    found: list[float] = []

    def take(event: dict[str, Any]) -> None:
        session.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})
        image = cv2.imdecode(np.frombuffer(base64.b64decode(event["data"]), np.uint8), cv2.IMREAD_GRAYSCALE)
        t_shown_ns = int(event["metadata"]["timestamp"] * 1e9) - wall_minus_mono_ns()
        t_exposed_ns = None if image is None else read(np.asarray(image, np.uint8), t_shown_ns)
        if t_exposed_ns is not None:
            found.append((t_shown_ns - t_exposed_ns) * 1e-6)

    session.on("Page.screencastFrame", take)
    session.send("Page.startScreencast", {"format": "jpeg", "quality": 80, "everyNthFrame": 1})
    page.wait_for_timeout(1e3 * seconds)
    session.send("Page.stopScreencast")
    return found
