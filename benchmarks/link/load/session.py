"""Link and vision at work together, minute by minute: trajectories without pause on the one, pictures on the other."""

import asyncio
import os
import statistics
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from benchmarks.link.load.back_and_forth import back_and_forth
from benchmarks.link.load.minute import Marks, Minute, wire_figures
from benchmarks.link.load.tap import Tap
from benchmarks.link.load.usage import cpu_s, major_faults, policy
from machine.description import Machine
from server.camera.contracts import FrameReport
from server.link.contracts import LinkHealth, MotionEnded, PlcSample
from server.link.errors import LinkError
from server.motion.contracts import JointTrajectory

_FIRST_STATE_S = 60.0  # the PLC compiles before it answers
_AGAIN_S = 0.5
_ARM_AGAIN_S = 30.0
_LEFT_OUT_S = 1.0  # of a minute: not worth another trajectory


class Link(Protocol):
    """What both clients have in common."""

    @property
    def health(self) -> LinkHealth:
        """Counters and timing."""
        ...

    @property
    def latest(self) -> PlcSample | None:
        """The newest sample."""
        ...

    async def start(self) -> None:
        """Begin to connect."""
        ...

    async def arm(self, timeout_s: float = 5.0) -> None:
        """Arm."""
        ...

    async def run(self, trajectory: JointTrajectory) -> MotionEnded:
        """Play to the end."""
        ...

    async def close(self) -> None:
        """End."""
        ...


class Vision(Protocol):
    """What both ways of running vision have in common."""

    def on_report(self, callback: Callable[[FrameReport], None]) -> None:
        """Call this with every pair."""
        ...

    async def start(self) -> None:
        """Begin."""
        ...

    async def start_odometry(self) -> None:
        """Returns with the first pair."""
        ...

    async def close(self) -> None:
        """End."""
        ...


class PairCounter:
    """Pairs since the last asking, and how long each took."""

    def __init__(self, vision: Vision) -> None:
        self._process_ms: list[float] = []
        vision.on_report(self._note)

    def _note(self, report: FrameReport) -> None:
        self._process_ms.append(report.process_ms)

    def take(self) -> tuple[int, float]:
        """How many, and the median of their times [ms]."""
        taken, self._process_ms = self._process_ms, []
        return len(taken), statistics.median(taken) if taken else 0.0


async def vision_alone(vision: Vision, seconds: float) -> tuple[float, float]:
    """Pairs a second that vision holds with nothing beside it, and the median time for one [ms]."""
    counter = PairCounter(vision)
    await vision.start()
    try:
        await vision.start_odometry()
        counter.take()
        started_s = time.monotonic()
        await asyncio.sleep(seconds)
        pairs, process_ms = counter.take()
        return pairs / (time.monotonic() - started_s), process_ms
    finally:
        await vision.close()


class Session:
    """One client, one vision, one PLC; `pids` names the processes whose cost is told."""

    def __init__(
        self, where: str, link: Link, vision: Vision, tap: Tap, machine: Machine, pids: Callable[[], dict[str, int]]
    ) -> None:
        self._where, self._link, self._vision, self._tap = where, link, vision, tap
        self._machine, self._pids = machine, pids
        self._pairs = PairCounter(vision)
        self._marks = Marks()

    async def start(self) -> None:
        """Bring both up, and arm."""
        await self._vision.start()
        await self._link.start()
        await self._vision.start_odometry()
        await self._arm(_FIRST_STATE_S)
        self._take_marks()

    async def close(self) -> None:
        """End both."""
        await self._vision.close()
        await self._link.close()

    async def minute(self, number: int, seconds: float) -> Minute:
        """Move for that long; the figures of that time. A motion that ends early is begun again."""
        self._take_marks()
        self._pairs.take()
        pids = self._pids()
        cpu_before = {name: cpu_s(pid) for name, pid in pids.items()}
        faults_before = {name: major_faults(pid) for name, pid in pids.items()}
        started_s = time.monotonic()
        interruptions = await self._move_for(seconds)
        took_s = time.monotonic() - started_s
        pairs, process_ms = self._pairs.take()
        wire: dict[str, Any] = wire_figures(self._tap.take(), self._marks, self._link.health)
        return Minute(
            number=number,
            where=self._where,
            seconds=took_s,
            interruptions=interruptions,
            pairs=pairs,
            process_ms=process_ms,
            cpu_frac={name: (cpu_s(pid) - cpu_before[name]) / took_s for name, pid in pids.items()},
            major_faults={name: major_faults(pid) - faults_before[name] for name, pid in pids.items()},
            policies={name: policy(pid) for name, pid in pids.items()},
            load_average=os.getloadavg()[0],
            **wire,
        )

    async def _move_for(self, seconds: float) -> list[str]:
        """Why trajectories ended early; the rest of the time is then moved anew."""
        interruptions: list[str] = []
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > _LEFT_OUT_S:
            try:
                trajectory = self._trajectory(left_s)
                self._tap.expect(len(trajectory.t_s) - 1)
                ended = await self._link.run(trajectory)
            except LinkError as error:
                interruptions.append(f"not begun: {error}")
            else:
                if ended.reached:
                    break
                interruptions.append(ended.reason)
            await asyncio.sleep(_AGAIN_S)
            await self._arm(_ARM_AGAIN_S)
        return interruptions

    def _trajectory(self, seconds: float) -> JointTrajectory:
        latest = self._link.latest
        if latest is None:
            raise LinkError("no state of the PLC yet; wait for it")
        return back_and_forth(self._machine, np.array(latest.q_ref_rad), seconds)

    async def _arm(self, timeout_s: float) -> None:
        """Arm, however often it takes.

        Raises: LinkError: not in that time.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            try:
                return await self._link.arm(5.0)
            except LinkError:
                if time.monotonic() > deadline_s:
                    raise
                await asyncio.sleep(_AGAIN_S)

    def _take_marks(self) -> None:
        tap = self._tap.take()
        self._marks = Marks(tap.underruns, tap.lost_to_plc, tap.watchdog_trips, self._link.health.lost)
