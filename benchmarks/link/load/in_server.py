"""The comparison: the same client and the same vision pipeline inside one process, as a naive server would have them.

The link is an asyncio task at 50 Hz, vision a thread beside it. Nothing here is used by the product.
"""

import asyncio
import contextlib
import secrets
import threading
import time
from collections.abc import Callable

import cv2

from machine.description import Machine
from protocol.client_events import ClientEvent, ClientPhase, LinkClosed, RejectSeen, StateReceived, TrajectoryEnded
from protocol.client_link import ClientLink
from protocol.errors import LocalProtocolError
from protocol.framing import RawFraming
from protocol.limits import limits_of
from protocol.messages import Knot, pad_to_eight_axes
from protocol.timeouts import COMMAND_PERIOD
from recording.clock import mono_ns
from server.camera.contracts import FrameReport, VisionSettings
from server.camera.process import READ_TIMEOUT_S, build_pipeline
from server.camera.sources.opening import open_source
from server.link.contracts import LinkHealth, LinkPhase, MotionEnded, PlcSample
from server.link.errors import LinkRefusedError
from server.link.lateness import Lateness
from server.link.samples import knots_of, sample_of
from server.link.udp_end import UdpEnd
from server.motion.contracts import JointTrajectory


class InServerLink:
    """The client end of the link as a task of this event loop; has the face of `server.link.client.LinkClient`."""

    def __init__(self, plc_port: int, machine: Machine) -> None:
        self._plc, self._machine = ("127.0.0.1", plc_port), machine
        self._link = self._new_link()
        self._udp: UdpEnd | None = None
        self._task: asyncio.Task[None] | None = None
        self._lateness, self._changed = Lateness(), asyncio.Event()
        self._lost = self._rejected = self._traj_id = 0
        self._last_reject = ""
        self._motion: asyncio.Future[MotionEnded] | None = None
        self.latest: PlcSample | None = None

    def _new_link(self) -> ClientLink:
        return ClientLink(limits_of(self._machine.joints), RawFraming(), session=secrets.randbelow(0xFFFF_FFFF) + 1)

    async def start(self) -> None:
        """Open the socket and begin to send."""
        self._udp = udp = UdpEnd(("127.0.0.1", 0))
        asyncio.get_running_loop().add_reader(udp.fileno(), self._drain, udp)
        self._task = asyncio.create_task(self._send_in_time(udp))

    async def close(self) -> None:
        """End the task; the PLC's watchdog does the rest."""
        if self._task is not None and self._udp is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
            asyncio.get_running_loop().remove_reader(self._udp.fileno())
            self._udp.close()

    @property
    def health(self) -> LinkHealth:
        """As the link process would report it."""
        now_ns, figures, counters = mono_ns(), self._lateness.figures(), self._link.counters
        return LinkHealth(
            phase=LinkPhase(self._link.phase(now_ns).value),
            age_ms=self._link.age_ns(now_ns) / 1e6,
            sent=counters.sent,
            received=counters.received,
            lost=self._lost + counters.lost,
            rejected=self._rejected,
            lateness_p50_us=figures.p50_us,
            lateness_p99_us=figures.p99_us,
            lateness_max_us=figures.max_us,
            round_trip_ms=self._link.clock_offset.delay_ns / 1e6,
            last_reject=self._last_reject,
            session=self._link.session,
            warning="in the server's process, at normal priority",
            round_trip_min_ms=self._link.clock_offset.delay_min_ns / 1e6,
        )

    async def arm(self, timeout_s: float = 5.0) -> None:
        """Arm. Raises: LinkRefusedError: not armed in time."""
        deadline_s = time.monotonic() + timeout_s
        while self._link.phase(mono_ns()) is not ClientPhase.ARMED:
            if time.monotonic() > deadline_s:
                raise LinkRefusedError(f"not armed: {self._last_reject or self.health.phase.value}")
            self._link.request_arm()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.3):
                    await self._changed.wait()
            self._changed.clear()

    async def run(self, trajectory: JointTrajectory) -> MotionEnded:
        """Play a trajectory from the present reference and wait for its end. Raises: LinkRefusedError."""
        knots = [
            Knot(t, pad_to_eight_axes(q), pad_to_eight_axes(qd), pad_to_eight_axes(qdd))
            for t, q, qd, qdd in knots_of(trajectory, len(self._machine.joints))
        ]
        self._traj_id += 1
        try:
            refusals = self._link.request_run(self._traj_id, knots, mono_ns())
        except LocalProtocolError as error:
            raise LinkRefusedError(str(error)) from error
        if refusals:
            raise LinkRefusedError(refusals[0].as_line)
        self._motion = asyncio.get_running_loop().create_future()
        return await self._motion

    async def _send_in_time(self, udp: UdpEnd) -> None:
        period_ns = COMMAND_PERIOD.duration_ns
        deadline_ns = mono_ns() + period_ns
        while True:
            await asyncio.sleep(max(0, deadline_ns - mono_ns()) * 1e-9)
            now_ns = mono_ns()
            self._handle(self._link.poll(now_ns))
            datagram = self._link.send(now_ns)
            if datagram is not None and udp.send(datagram, self._plc):
                self._lateness.add(mono_ns() - deadline_ns)
            deadline_ns += ((now_ns - deadline_ns) // period_ns + 1) * period_ns

    def _drain(self, udp: UdpEnd) -> None:
        for datagram, t_mono_ns, _ in udp.drain():
            self._handle(self._link.receive(datagram, t_mono_ns))

    def _handle(self, events: list[ClientEvent]) -> None:
        for event in events:
            match event:
                case StateReceived(state=state, t_mono_ns=t_mono_ns):
                    self.latest = sample_of(state, t_mono_ns, len(self._machine.joints))
                case TrajectoryEnded(traj_id=traj_id, reached=reached, reason=reason, t_plc_ns=t_plc_ns):
                    if self._motion is not None and not self._motion.done():
                        self._motion.set_result(MotionEnded(traj_id, reached, reason, t_plc_ns))
                case RejectSeen(text=text):
                    self._rejected += 1
                    self._last_reject = text
                case LinkClosed():
                    self._lost += self._link.counters.lost
                    self._link, self._traj_id = self._new_link(), 0
                case _:
                    pass
        self._changed.set()


class InServerVision:
    """The vision pipeline in a thread of this process; has the face of `server.camera.client.VisionClient`."""

    def __init__(self, settings: VisionSettings, machine: Machine) -> None:
        self._settings, self._machine = settings, machine
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._callbacks: list[Callable[[FrameReport], None]] = []
        self._ready = asyncio.Event()

    def on_report(self, callback: Callable[[FrameReport], None]) -> None:
        """Call this with every report, on the loop."""
        self._callbacks.append(callback)

    async def start(self) -> None:
        """Start the thread."""
        self._thread = threading.Thread(target=self._work, args=(asyncio.get_running_loop(),), daemon=True)
        self._thread.start()

    async def start_odometry(self) -> None:
        """Returns with the first report: odometry is on from the start here."""
        await self._ready.wait()

    async def close(self) -> None:
        """End the thread."""
        self._stopped.set()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 5.0)

    def _work(self, loop: asyncio.AbstractEventLoop) -> None:
        cv2.setNumThreads(self._settings.threads)
        pipeline = build_pipeline(self._settings, self._machine)
        source = open_source(self._settings.source)
        pipeline.switch_odometry(True)
        try:
            while not self._stopped.is_set():
                frame = source.read(READ_TIMEOUT_S)
                if frame is not None:
                    loop.call_soon_threadsafe(self._take, pipeline.process(frame, source.skipped))
        except RuntimeError:  # the loop is closed: nobody listens any more
            return
        finally:
            source.close()
            pipeline.close()

    def _take(self, report: FrameReport) -> None:
        self._ready.set()
        for callback in self._callbacks:
            callback(report)
