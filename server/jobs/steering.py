"""Motion while looking, carried out: a trajectory under way, its pairs as they come, and its corrections.

Nothing here waits for the link while a pair may be lost: corrections are answered by the next pair's report.
"""

import asyncio
from collections import deque
from typing import Literal

import numpy as np

from recording.clock import mono_ns, mono_s
from server.calibration.contracts import Array
from server.camera.contracts import FrameReport
from server.errors import JobFailedError
from server.jobs.cell import Cell
from server.jobs.requests import Correct, NextPair, PairSeen
from server.link.contracts import MotionEnded
from server.link.errors import LinkRefusedError
from server.motion.contracts import JointTrajectory

ENCODER_GAP_S = 0.05  # an exposure further than this from any encoder sample cannot be joined with them
ENCODER_WAIT_MAX_S = 0.1  # how long a pair may wait for encoders that are still on their way
ENCODERS_POLL_S = 0.005
ENCODER_HISTORY_S = 1.0
MOTION_END_TIMEOUT_S = 0.1  # a stopped motion reports its end immediately
LATENCY_PAIRS = 300  # pairs over which the smallest latency is known: 5 s at 60 a second, 20 s at 15
FIRST_PAIR_TIMEOUT_S = 0.25  # from asking for the motion to the first pair that is judged: one step of the plan
STEER_TIMEOUT_GRACE_S = 0.03  # the link's own stop comes after the plan's, which says why


class Steering:
    """At most one motion at a time; used from one event loop."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._motion: asyncio.Task[MotionEnded] | None = None
        self._tail: asyncio.Task[None] | None = None
        self._listening = False
        self._number, self._t_arrival_s = 0, 0.0
        self._latencies_s: deque[float] = deque(maxlen=LATENCY_PAIRS)
        self._report: FrameReport | None = None
        self._arrived = asyncio.Event()

    async def start(self, trajectory: JointTrajectory) -> None:
        """Hand the trajectory to the link; its refusal is reported by `wait_for_end` or shows as an ended motion."""
        self._subscribe_to_vision_reports()
        self._tail = None
        await self._let_go_on(FIRST_PAIR_TIMEOUT_S)
        self._motion = asyncio.create_task(self._cell.link.run(trajectory), name="steered-motion")
        await asyncio.sleep(0.0)

    async def next_pair(self, request: NextPair) -> PairSeen:
        """The newest pair after a number, or a silence, or the motion's end, whichever comes first.

        A pair without a fault lets the motion go on; without one the link ends it, whatever this process does.
        """
        self._subscribe_to_vision_reports()
        seen = await self._wait_for_pair(request)
        if not seen.fault and not seen.motion_ended:
            await self._let_go_on(request.silence_max_s + STEER_TIMEOUT_GRACE_S)
        return seen

    async def _wait_for_pair(self, request: NextPair) -> PairSeen:
        deadline_s = max(self._t_arrival_s, mono_s() - request.silence_max_s) + request.silence_max_s
        while self._number <= request.after_number:
            left_s = deadline_s - mono_s()
            if left_s <= 0.0:
                silent = f"no pair for {1e3 * request.silence_max_s:.0f} ms; check the camera, its cable and its rate"
                return self._make_pair_seen(request.after_number, silent, None, request)
            try:
                async with asyncio.timeout(left_s):
                    await self._arrived.wait()
            except TimeoutError:
                continue
        await self._encoders_come(request)
        return self._make_pair_seen(self._number, "", self._report, request)

    async def _encoders_come(self, request: NextPair) -> None:
        """Encoders come by another process: a pair that arrives before them must not end a motion."""
        until_s = mono_s() + min(ENCODER_WAIT_MAX_S, request.silence_max_s)
        while self._encoders_due(request) and mono_s() < until_s:  # noqa: ASYNC110 samples are no event
            await asyncio.sleep(ENCODERS_POLL_S)

    def _encoders_due(self, request: NextPair) -> bool:
        """Whether the newest pair was exposed after the newest sample, by more than may be joined."""
        latest, offset_ns = self._cell.link.latest, self._cell.link.plc_to_pc_offset_ns
        if self._report is None or latest is None or offset_ns is None:
            return False
        exposed_s = self._report.t_exposure_mapped_ns * 1e-9 + request.time_offset_s
        return exposed_s - (latest.t_plc_ns + offset_ns) * 1e-9 > ENCODER_GAP_S

    def correct(self, request: Correct) -> None:
        """Send a new tail, the rest of the running trajectory. While one is on its way, another is refused."""
        self._tail = asyncio.create_task(
            self._cell.link.correct(request.trajectory, request.first_knot), name="new-tail"
        )

    async def wait_for_end(self) -> None:
        """Wait for the motion's end. Raises: JobFailedError: it ended early. LinkError: it was refused."""
        motion, self._motion = self._motion, None
        if motion is None:
            raise JobFailedError("no motion was started", "motion_ended_early")
        try:
            ended = await motion
        finally:
            await self._cell.link.steer_until(None)
        if not ended.reached:
            raise JobFailedError(f"closed loop: motion ended early: {ended.reason}", "motion_ended_early")

    async def forget_motion(self) -> None:
        """The machine was stopped: the motion ends by that, and whatever is left of it is of no interest."""
        if self._motion is not None:
            await asyncio.wait({self._motion}, timeout=MOTION_END_TIMEOUT_S)
        for task in (self._motion, self._tail):
            if task is not None:
                task.cancel()
                task.add_done_callback(_looked_at)
        self._motion = self._tail = None
        await self._cell.link.steer_until(None)

    async def _let_go_on(self, for_s: float) -> None:
        await self._cell.link.steer_until(mono_ns() + int(for_s * 1e9))

    def _subscribe_to_vision_reports(self) -> None:
        if not self._listening:
            self._listening, self._t_arrival_s = True, mono_s()
            self._cell.vision.on_report(self._on_report)

    def _on_report(self, report: FrameReport) -> None:
        self._number, self._report, self._t_arrival_s = self._number + 1, report, mono_s()
        self._latencies_s.append(self._t_arrival_s - report.t_exposure_mapped_ns * 1e-9)
        self._arrived.set()
        self._arrived = asyncio.Event()

    def _make_pair_seen(self, number: int, fault: str, report: FrameReport | None, request: NextPair) -> PairSeen:
        tail, tail_text = self._tail_state()
        q = None
        if report is not None:
            q = self._joints_at(report.t_exposure_mapped_ns * 1e-9 + request.time_offset_s)
            fault = "; ".join(report.warnings) or self._too_old(report, request.silence_max_s)
            fault = fault or ("" if q is not None else "no encoders at the pair's exposure")
        return PairSeen(
            number=number,
            fault=fault,
            tool=report.observation.tool if report else None,
            ooi=report.observation.ooi if report else None,
            q_rad=q,
            t_play_s=self._t_play_s(),
            motion_ended=self._motion is None or self._motion.done(),
            tail_status=tail,
            tail_text=tail_text,
        )

    def _too_old(self, report: FrameReport, silence_max_s: float) -> str:
        """Why the pair is too old to act on: it does not show what has come into view since. Empty when it is not.

        Its age counts from its exposure: a process that stalls takes an old pair for one that has just come.
        """
        age_s = mono_s() - report.t_exposure_mapped_ns * 1e-9
        fastest_s = max(min(self._latencies_s), 0.0)
        if age_s <= silence_max_s + fastest_s:
            return ""
        limit_ms = 1e3 * (silence_max_s + fastest_s)
        return f"the newest pair is {1e3 * age_s:.0f} ms old (limit {limit_ms:.0f} ms); this computer is overloaded"

    def _tail_state(self) -> tuple[Literal["none", "pending", "taken", "refused"], str]:
        """What became of the last correction; reported once."""
        task = self._tail
        if task is None:
            return "none", ""
        if not task.done():
            return "pending", ""
        self._tail = None
        error = None if task.cancelled() else task.exception()
        if error is None:
            return "taken", ""
        if isinstance(error, LinkRefusedError):
            return "refused", str(error)
        raise error

    def _t_play_s(self) -> float:
        """Time on the running trajectory, as the PLC last reported it, and since."""
        latest = self._cell.link.latest
        if latest is None or latest.plc_state != "RUN":
            return 0.0
        return (latest.t_play_ns + mono_ns() - latest.t_mono_ns) * 1e-9

    def _joints_at(self, t_s: float) -> Array | None:
        """Encoders at a moment of the PC's clock, linear between samples."""
        link = self._cell.link
        samples = link.samples_since(mono_ns() - int(ENCODER_HISTORY_S * 1e9))
        if len(samples) < 2 or link.plc_to_pc_offset_ns is None:
            return None
        times = np.array([sample.t_plc_ns + link.plc_to_pc_offset_ns for sample in samples]) * 1e-9
        if np.abs(times - t_s).min() > ENCODER_GAP_S:
            return None
        qs = np.array([sample.q_rad for sample in samples])
        return np.array([np.interp(t_s, times, column) for column in qs.T])


def _looked_at(task: "asyncio.Task[object]") -> None:
    """Its error is known by the stop's reason: asyncio need not warn of it."""
    if not task.cancelled():
        task.exception()
