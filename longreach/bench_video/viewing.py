"""Viewers in a real browser on a live stack, and the time code read back from what the browser composed."""

import base64
import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import httpx
import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from longreach.link_load.usage import cpu_s
from longreach.processes import Stack
from sim_plc.camera.time_code import read

ALONE = """() => { const style = new CSSStyleSheet();
  style.replaceSync('header, #notices, footer, .column:last-child, .scene, h2 { display: none !important } '
    + 'main { display: block !important; padding: 0 !important } '
    + 'section { padding: 0 !important; border: 0 !important }');
  document.adoptedStyleSheets = [style]; }"""
DRAWN = "() => Number(document.getElementById('picture').dataset.drawn ?? 0)"


@dataclass(frozen=True, slots=True)
class Watched:
    """With so many viewers for so long: vision's rate, and what each viewer drew.

    `where`: "here": browsers that draw on this computer too; "elsewhere": sockets that take every frame and draw none,
    as viewers on other computers look to the server.
    """

    where: str
    viewers: int
    seconds: float
    vision_hz: float
    server_cpu_pct: float  # of one core: the server's own process, without vision's
    viewer_hz: tuple[float, ...]


def opened(browser: Any, url: str) -> Any:
    """A viewer: the page without its 3D view, which needs a graphics card that a test computer lacks."""
    page = browser.new_context(viewport={"width": 1280, "height": 720}).new_page()
    page.goto(f"{url}/?no3d")
    page.wait_for_function(f"() => ({DRAWN})() > 0", timeout=60_000)
    return page


def watch(stack: Stack, pages: list[Any], seconds: float) -> Watched:
    """Count for a while what each viewer draws."""
    return _watched("here", stack, [lambda page=page: int(page.evaluate(DRAWN)) for page in pages], seconds)


def watch_elsewhere(stack: Stack, count: int, seconds: float) -> Watched:
    """The same with viewers that only take the frames."""
    with contextlib.ExitStack() as opened:
        takers = [opened.enter_context(FrameTaker(stack.url)) for _ in range(count)]
        return _watched("elsewhere", stack, [lambda taker=taker: taker.taken for taker in takers], seconds)


def _watched(where: str, stack: Stack, counters: list[Callable[[], int]], seconds: float) -> Watched:
    server = stack.processes["server"].pid
    before, cpu_before_s, started = [count() for count in counters], cpu_s(server), time.monotonic()
    vision_hz = _pairs_seen(stack.url, seconds)
    drawn = [count() - earlier for count, earlier in zip(counters, before, strict=True)]
    took_s = time.monotonic() - started
    cpu_pct = round(100.0 * (cpu_s(server) - cpu_before_s) / took_s, 1)
    return Watched(where, len(drawn), round(took_s, 1), vision_hz, cpu_pct, tuple(round(n / took_s, 2) for n in drawn))


class FrameTaker(threading.Thread):
    """A viewer of the video channel that answers each frame at once. A context manager."""

    def __init__(self, url: str) -> None:
        super().__init__(name="frame-taker", daemon=True)
        self._socket = connect(url.replace("http", "ws", 1) + "/v1/video", max_size=None, compression=None)
        self.taken = 0

    def __enter__(self) -> "FrameTaker":
        self.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._socket.close()
        self.join(5.0)

    def run(self) -> None:
        """Until closed."""
        with contextlib.suppress(ConnectionClosed):
            for _ in self._socket:
                self.taken += 1
                self._socket.send("next")


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
