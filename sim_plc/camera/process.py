"""The camera process: exposes on a grid of true time, renders, and serves the pictures late by the camera's latency."""

import asyncio
import logging
import multiprocessing
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import uvicorn

from recording.clock import mono_ns
from sim_plc.camera.faults import SCENE_FAULTS, FaultKind, FaultSwitch, faulty_scene
from sim_plc.camera.frames import Frame, FrameHub
from sim_plc.camera.http_app import ExposureGrid, RateGovernor, TrueClock, camera_app
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.camera.texture import Grey
from sim_plc.pose_feed import PoseFeed, PoseFeedError
from sim_plc.world import World, rng_for

log = logging.getLogger(__name__)

CAMERA_EPOCH_NS = -3_000_000_000_000  # the camera's clock starts where neither the PLC's nor the PC's does
_POLL_S = 0.002
_FPS_WINDOW_S = 2.0
_SHUTDOWN_S = 1


# A time code painted into the picture, so that a screenshot shows its exposure time.
#
# 42 cells in one row at the top: a white and a black one to find grey levels by, then 40 bits of the exposure on the
# monotonic clock, in units of 0.1 ms, the highest first; wraps after 30 h.

TIME_CODE_BITS = 40
TIME_CODE_CELLS = TIME_CODE_BITS + 2
TIME_CODE_UNIT_NS = 100_000
TIME_CODE_HEIGHT_FRAC = 24.0 / 720.0


def paint_time_code(image: Grey, t_mono_ns: int) -> Grey:
    """A copy of the picture with its code over the full width."""
    out = image.copy()
    height = max(4, round(TIME_CODE_HEIGHT_FRAC * image.shape[0]))
    code = (t_mono_ns // TIME_CODE_UNIT_NS) % (1 << TIME_CODE_BITS)
    levels = [1, 0, *((code >> (TIME_CODE_BITS - 1 - i)) & 1 for i in range(TIME_CODE_BITS))]
    edges = np.linspace(0, image.shape[1], TIME_CODE_CELLS + 1).round().astype(int)
    for level, start, end in zip(levels, edges[:-1], edges[1:], strict=True):
        out[:height, start:end] = 235 if level else 16
    return out


class CameraLoop:
    """The rendering thread: pose feed in, stamped frames out. `deliver` gets each frame and its due time [mono ns]."""

    def __init__(
        self,
        world: World,
        rate_hz: float,
        jpeg_quality: int,
        faults: FaultSwitch,
        deliver: Callable[[Frame, int], None],
        time_code: bool = False,
    ) -> None:
        self.governor = RateGovernor(rate_hz)
        self.stop = threading.Event()
        self.frames = self.late = 0
        self.error = ""
        self._grid: ExposureGrid | None = None
        self._faulty_scenes: dict[FaultKind, StereoRenderer] = {}
        self._world, self._jpeg_quality, self._faults, self._deliver = world, jpeg_quality, faults, deliver
        self._clock = TrueClock()
        self._rng = rng_for(world.seed, "camera")
        self._done_mono_ns: deque[int] = deque(maxlen=200)
        self._due_mono_ns = 0
        self._time_code = time_code

    @property
    def skipped_count(self) -> int:
        """Exposures left out because rendering was behind."""
        return 0 if self._grid is None else self._grid.n_skipped

    def fps(self) -> float:
        """Pictures per second over the last two seconds."""
        since = mono_ns() - round(_FPS_WINDOW_S * 1e9)
        return sum(t >= since for t in tuple(self._done_mono_ns)) / _FPS_WINDOW_S

    def run(self, feed_name: str) -> None:
        """Until `stop` is set; a failure ends the pictures and is stored in `error`."""
        try:
            renderer = StereoRenderer(self._world)
            feed = self._attach_pose_feed(feed_name)
            if feed is not None:
                try:
                    self._run(renderer, feed)
                finally:
                    feed.close()
        except Exception as error:  # the outermost loop of this thread: /healthz reports it
            log.exception("camera loop ended")
            self.error = f"{type(error).__name__}: {error}"

    def _attach_pose_feed(self, feed_name: str) -> PoseFeed | None:
        """The pose feed once it holds poses; None when stopped before."""
        feed = PoseFeed.attach(feed_name)
        while not self.stop.is_set():
            try:
                feed.latest_t_ns()
            except PoseFeedError:
                self.stop.wait(_POLL_S)
            else:
                return feed
        feed.close()
        return None

    def _run(self, renderer: StereoRenderer, feed: PoseFeed) -> None:
        camera = self._world.camera
        half_ns = round(0.5e9 * (abs(camera.readout_s) + camera.exposure_s))
        renderer.render_static(feed.pose_at(feed.latest_t_ns()))  # compiles before the clock counts
        grid = self._grid = ExposureGrid(feed.latest_t_ns() + half_ns, self.governor.wanted_hz)
        while True:
            t_mid_ns = grid.next_exposure(feed.latest_t_ns() - half_ns)
            if not self._wait_for(feed, t_mid_ns + half_ns):
                return
            start = time.perf_counter()
            try:
                pair = self._renderer_with_fault(renderer).render(feed, t_mid_ns, self._rng)
            except PoseFeedError as error:  # starved for longer than the feed reaches back: take the next exposure
                log.warning("camera: exposure left out: %s", error)
                continue
            self._hand_over(*pair, t_mid_ns)
            if self.governor.record_busy_time(time.perf_counter() - start):
                grid.rate_hz = self.governor.rate_hz
                log.info("camera: %.1f pairs/s of %.1f wanted", grid.rate_hz, self.governor.wanted_hz)

    def _renderer_with_fault(self, renderer: StereoRenderer) -> StereoRenderer:
        """The renderer of the scene as the chosen fault leaves it; made when first requested."""
        kind = self._faults.kind
        if kind not in SCENE_FAULTS:
            return renderer
        if kind not in self._faulty_scenes:
            scene = faulty_scene(kind, self._world.scene)
            self._faulty_scenes[kind] = StereoRenderer(replace(self._world, scene=scene))
        return self._faulty_scenes[kind]

    def _wait_for(self, feed: PoseFeed, t_ns: int) -> bool:
        """Until the feed has reached a time; False when stopped."""
        while not self.stop.is_set():
            latest_ns = feed.latest_t_ns()
            self._clock.note_pose_time(latest_ns, mono_ns())
            if latest_ns >= t_ns:
                return True
            self.stop.wait(max(_POLL_S, min(1e-9 * (t_ns - latest_ns), 0.05)))
        return False

    def _hand_over(self, left: Grey, right: Grey, t_mid_ns: int) -> None:
        camera = self._world.camera
        if self._time_code:
            left = paint_time_code(left, self._clock.mono_ns(t_mid_ns))
        jpeg = self._faults.sent(left, right, self._jpeg_quality)
        t_exposure_ns = self._faults.stamp(t_mid_ns + round(1e9 * camera.clock_offset_s) + CAMERA_EPOCH_NS)
        if jpeg is None:
            return
        latency_s = max(0.0, camera.latency_s + camera.jitter_s * self._rng.standard_normal())
        due_ns = max(self._clock.mono_ns(t_mid_ns + round(1e9 * latency_s)), self._due_mono_ns + 1)
        self._due_mono_ns = due_ns
        self.frames += 1
        now_ns = mono_ns()
        self.late += now_ns > due_ns
        self._done_mono_ns.append(now_ns)
        self._deliver(Frame(jpeg, t_exposure_ns, self.frames), due_ns)


def health_of(loop: CameraLoop, hub: FrameHub) -> dict[str, Any]:
    """The state for /healthz; rates in pictures per second."""
    status = "failed" if loop.error else "ok" if hub.newest is not None else "starting"
    return {
        "status": status,
        "error": loop.error,
        "rate_hz": loop.governor.wanted_hz,
        "effective_rate_hz": round(loop.governor.rate_hz, 2),
        "reduced": loop.governor.reduced,
        "fps": loop.fps(),
        "busy_ms": round(1e3 * loop.governor.busy_s, 1),
        "frames": loop.frames,
        "skipped": loop.skipped_count,
        "late": loop.late,
        "clients": hub.n_clients,
        "client_skipped": hub.skipped_count,
    }


class _StreamEndingServer(uvicorn.Server):
    """A uvicorn server that ends the streams first, so that shutting down does not wait for the clients."""

    def __init__(self, config: uvicorn.Config, hub: FrameHub) -> None:
        super().__init__(config)
        self._hub = hub

    async def shutdown(self, sockets: Any = None) -> None:
        self._hub.close()
        await super().shutdown(sockets)


def _end_with_parent(server: uvicorn.Server, loop: asyncio.AbstractEventLoop) -> None:
    """End the server when the process that started this one has died: its sentinel then becomes readable."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def on_parent_ended() -> None:
        loop.remove_reader(parent.sentinel)
        server.should_exit = True

    loop.add_reader(parent.sentinel, on_parent_ended)


async def _serve(
    world: World, feed_name: str, host: str, port: int, rate_hz: float, jpeg_quality: int, faults: bool, time_code: bool
) -> None:
    hub = FrameHub()
    switch = FaultSwitch()
    loop = asyncio.get_running_loop()

    def deliver(frame: Frame, due_mono_ns: int) -> None:
        delay_s = max(0.0, 1e-9 * (due_mono_ns - mono_ns()))
        loop.call_soon_threadsafe(loop.call_later, delay_s, hub.publish, frame)

    camera = CameraLoop(world, rate_hz, jpeg_quality, switch, deliver, time_code)
    app = camera_app(hub, lambda: health_of(camera, hub), switch if faults else None)
    config = uvicorn.Config(
        app, host=host, port=port, log_level="warning", lifespan="off", timeout_graceful_shutdown=_SHUTDOWN_S
    )
    server = _StreamEndingServer(config, hub)
    thread = threading.Thread(target=camera.run, args=(feed_name,), name="camera-loop", daemon=True)
    thread.start()
    _end_with_parent(server, loop)
    try:
        await server.serve()
    finally:
        camera.stop.set()
        await asyncio.to_thread(thread.join, 2.0)


def run_camera(
    world: World,
    feed_name: str,
    host: str,
    port: int,
    rate_hz: float,
    jpeg_quality: int = 95,
    faults: bool = False,
    time_code: bool = False,
) -> None:
    """Serve the simulated camera until SIGTERM or SIGINT, or until the parent process is gone.

    Args:    world: what there is to see. feed_name: pose feed of the PLC process. rate_hz: wanted pairs per second.
             faults: whether POST /fault is obeyed. time_code: the exposure's time is painted into the left picture.
    """
    cv2.setNumThreads(1)  # leaves the other core to the PLC process and the server
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)  # uvicorn handles them while it serves, then raises them again
    asyncio.run(_serve(world, feed_name, host, port, rate_hz, jpeg_quality, faults, time_code))
