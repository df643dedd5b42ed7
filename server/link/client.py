"""The server's handle on the PLC link: arm, run a trajectory, stop, and the samples that come back."""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

from machine.description import Machine
from protocol.gate import check_trajectory
from protocol.limits import limits_of
from protocol.messages import pad_to_eight_axes
from recording.clock import mono_ns, mono_s
from server.link.contracts import (
    ArmRequest,
    BindFailed,
    CorrectRequest,
    DisarmRequest,
    HealthReport,
    HoldRequest,
    LinkHealth,
    LinkPhase,
    LinkReport,
    LinkRequest,
    MotionEnded,
    PlcSample,
    ResetRequest,
    RunRefused,
    RunRequest,
    SamplesReport,
    SilenceRequest,
    SteerRequest,
    StopRequest,
    TailReport,
)
from server.link.errors import LinkError, LinkRefusedError, LinkSilentError
from server.link.samples import KnotTuple, SampleCallback, SampleRing, knots_from, knots_of, refusals_text
from server.link.settings import LinkSettings, framing_of
from server.link.supervised import SupervisedProcess
from server.motion.contracts import JointTrajectory

_LOG = logging.getLogger(__name__)
_ARM_REPEAT_S = 0.3
_START_S = 60.0  # spawning a Python process on a busy small computer: 20 s were seen
_STOP_S = 3.0  # the slowest ramp takes half a second
_RESTART_S = 1.0
_HEALTH_STALE_NS = 1_000_000_000
_ARMED = (LinkPhase.ARMED, LinkPhase.RUNNING, LinkPhase.STOPPING)
_MOVING = (LinkPhase.RUNNING, LinkPhase.STOPPING)
_NO_HEALTH = LinkHealth(LinkPhase.OFFLINE, 3.6e6, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 0)


class LinkClient:
    """Owns the link process: starts it, restarts it if it dies, ends it. All methods belong to one event loop."""

    def __init__(self, settings: LinkSettings, machine: Machine) -> None:
        framing_of(settings)  # a wrong NetId is reported now, not by a dead process
        self._settings = settings
        self._table = limits_of(machine.joints)
        self._ring = SampleRing()
        self._dropped = 0
        self._process: SupervisedProcess | None = None
        self._health, self._t_health_ns = _NO_HEALTH, 0
        self._offset_ns: int | None = None
        self._changed = asyncio.Event()
        self._traj_id = self._stops = self._disarms = self._disarming = 0
        self._motion: asyncio.Future[MotionEnded] | None = None
        self._tail: asyncio.Future[TailReport] | None = None
        self._restart: asyncio.Task[None] | None = None
        self._closing, self._unbound = False, ""

    # --- life -------------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Start the link process and wait until it reports; whether the PLC answers shows in `health`.

        Raises: LinkSilentError: the process did not come up.
        """
        await self._spawn()
        if not await self._until(lambda: self._t_health_ns > 0, _START_S):
            await self.close()
            why = self._health.error or "the log says why"
            raise LinkSilentError(f"the link process did not report within {_START_S:.0f} s; {why}")

    async def close(self) -> None:
        """End the link process; a moving machine is ramped down first."""
        self._closing = True
        if self._restart:
            self._restart.cancel()
        if self._process:
            process, self._process = self._process, None
            await process.end_process()
        self._end_motion("the link was closed")

    async def _spawn(self) -> None:
        process = SupervisedProcess(self._settings, self._table, self._on_report, lambda: self._on_gone(process))
        self._process = process
        await process.start()

    # --- what is known ----------------------------------------------------------------------------------------------

    @property
    def health(self) -> LinkHealth:
        """The newest health; OFFLINE if the link process itself is silent for a second."""
        if mono_ns() - self._t_health_ns > _HEALTH_STALE_NS:
            return replace(self._health, phase=LinkPhase.OFFLINE, error=self._health.error or "link process is silent")
        return self._health

    @property
    def latest(self) -> PlcSample | None:
        """The newest PLC sample, however old."""
        return self._ring.latest

    def samples_since(self, t_mono_ns: int) -> list[PlcSample]:
        """The samples received after a time, at most three minutes of them."""
        return self._ring.samples_since(t_mono_ns)

    def on_sample(self, callback: SampleCallback) -> Callable[[], None]:
        """Call back for every sample (in the event loop, so be quick); the answer unsubscribes."""
        return self._ring.subscribe(callback)

    @property
    def listener_problem(self) -> str:
        """Which of those that `on_sample` calls failed lately, and how."""
        return self._ring.listeners.recent_failure

    @property
    def plc_to_pc_offset_ns(self) -> int | None:
        """t_pc = t_plc + offset, monotonic clocks; None before the first exchange."""
        return self._offset_ns

    @property
    def process_id(self) -> int | None:
        """Of the link process, for the operator's eyes and for tests."""
        return self._process.pid if self._process else None

    # --- commands ---------------------------------------------------------------------------------------------------

    async def arm(self, timeout_s: float = 5.0) -> None:
        """Open a session and arm; returns when the PLC holds. Needs local enable at the machine.

        Raises: LinkSilentError, LinkRefusedError: with the PLC's last reject, or because of a stop or disarm meanwhile.
        """
        deadline_s, stops, disarms = mono_s() + timeout_s, self._stops, self._disarms
        self._refuse_if_stopped(stops, disarms)
        while self.health.phase not in _ARMED:
            if self.health.phase in (LinkPhase.FAULT, LinkPhase.LOCAL):
                raise LinkRefusedError(self._why_not_armed())
            left_s = deadline_s - mono_s()
            if left_s <= 0:
                await self._request(StopRequest("arming was cancelled"))
                silent = self.health.phase is LinkPhase.OFFLINE
                raise (LinkSilentError if silent else LinkRefusedError)(self._why_not_armed())
            await self._request(ArmRequest())
            await self._until(lambda: self.health.phase in _ARMED, min(left_s, _ARM_REPEAT_S))
            self._refuse_if_stopped(stops, disarms)

    async def run(self, trajectory: JointTrajectory) -> MotionEnded:
        """Play a trajectory from the present reference and wait for its end. Cancelled: stops the machine first.

        Raises: LinkRefusedError: not armed, busy, or the motion gate says no. LinkSilentError: the process is gone.
        """
        if self._motion is not None:
            raise LinkRefusedError("a trajectory is running; wait for its end or stop it")
        if self.health.phase is not LinkPhase.ARMED:
            raise LinkRefusedError(f"PLC link is {self.health.phase.value}, must be armed and at rest; arm first")
        knots, stops = knots_of(trajectory, len(self._table.axes)), self._stops
        await self._check_motion_gate(knots)
        if stops != self._stops:  # a STOP in the meantime must not be followed by the motion it was meant for
            raise LinkRefusedError("the machine was stopped before the trajectory was sent; plan again")
        self._traj_id += 1
        motion = self._motion = asyncio.get_running_loop().create_future()
        try:
            await self._request(RunRequest(self._traj_id, knots))
            return await asyncio.shield(motion)
        except asyncio.CancelledError:
            await asyncio.shield(self.stop("the job was cancelled"))
            raise
        finally:
            self._motion = None
            if not motion.cancel() and not motion.cancelled():
                motion.exception()  # looked at: asyncio need not warn of it

    async def correct(self, trajectory: JointTrajectory, first: int) -> None:
        """Replace the running trajectory from its knot `first` on by `trajectory`, whose times count from its start.

        The new knots join the trajectory's own knot before them: the splice is on the reference. `run` goes on waiting
        for the end. Returns when the PLC has taken the new tail.

        Raises: LinkRefusedError: nothing runs, too near, or the gate or the PLC says no; the old tail goes on.
        """
        motion = self._motion
        if motion is None or motion.done() or self._tail is not None:
            raise LinkRefusedError("no trajectory is under way that could be corrected, or a correction is on its way")
        tail = self._tail = asyncio.get_running_loop().create_future()
        try:
            knots = knots_of(trajectory, len(self._table.axes))
            await self._request(CorrectRequest(self._traj_id, first, knots))
            await asyncio.wait((tail, motion), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._tail = None
        if not tail.done() or not tail.result().taken:
            raise LinkRefusedError(tail.result().text if tail.done() else "the trajectory ended before the correction")

    async def go_silent(self, duration_s: float) -> None:
        """Send nothing for a while, as if this PC were gone: the PLC has to stop by itself. For commissioning."""
        await self._request(SilenceRequest(duration_s))

    async def hold_until(self, t_mono_ns: int | None) -> None:
        """Let motion go on until then only [monotonic ns]; None: it need not be held any more."""
        with contextlib.suppress(LinkSilentError):  # no process, no motion
            await self._request(HoldRequest(t_mono_ns))

    async def steer_until(self, t_mono_ns: int | None) -> None:
        """Let steered motion go on until then only [monotonic ns]; None: nothing is steered any more."""
        with contextlib.suppress(LinkSilentError):  # no process, no motion
            await self._request(SteerRequest(t_mono_ns))

    async def quick_stop(self, reason: str) -> None:
        """Every joint to rest as fast as it may; like `stop` otherwise."""
        await self.stop(reason, quick=True)

    async def _check_motion_gate(self, knots: Sequence[KnotTuple]) -> None:
        """The motion gate on the whole trajectory, here in a thread: the link process has no time for it.

        There every knot is judged again when it is sent.
        """
        found = await asyncio.to_thread(
            check_trajectory, knots_from(knots), pad_to_eight_axes(knots[0][1]), self._table
        )
        if found:
            raise LinkRefusedError(refusals_text(found))

    async def stop(self, reason: str, quick: bool = False) -> None:
        """Ramp down along the path and hold; returns when the PLC is at rest, at the latest after 3 s.

        If the PLC is not heard or the process is gone, its watchdog stops the machine: that is logged, not raised.
        """
        motion = self._motion
        self._stops += 1

        def at_rest() -> bool:
            return self.health.phase not in _MOVING and (motion is None or motion.done())

        try:
            await self._request(StopRequest(reason, quick))
        except LinkSilentError as error:
            _LOG.warning("stop (%s) could not be sent, the PLC stops by its watchdog: %s", reason, error)
            return
        if not await self._until(at_rest, _STOP_S):
            phase = self.health.phase.value
            raise LinkError(f"stop ({reason}): PLC still {phase} after {_STOP_S:.0f} s; use the emergency stop")

    async def disarm(self) -> None:
        """Leave the armed state (ramping down first if it moves); an arming that is under way ends refused.

        It is always requested: the last state may be old, and an ARM may be on its way. Success is what the PLC
        says after that.

        Raises: LinkSilentError: the PLC did not answer within 3 s, or the process is gone. LinkError: still armed then.
        """
        self._stops += 1
        self._disarms += 1
        self._disarming += 1
        try:
            await self._request(DisarmRequest())
            if not await self._until(self._reported_unarmed_since(mono_ns()), _STOP_S):
                raise self._why_not_disarmed()
        finally:
            self._disarming -= 1

    async def reset(self) -> None:
        """Clear a latched fault; nothing moves, arm again afterwards.

        Raises: LinkRefusedError: the fault is still there after 3 s.
        """
        if self.health.phase is not LinkPhase.FAULT:
            return
        await self._request(ResetRequest())
        if not await self._until(lambda: self.health.phase is not LinkPhase.FAULT, _STOP_S):
            raise LinkRefusedError(f"reset: the fault is still there ({self.health.last_reject}); remove its cause")

    # --- inside -----------------------------------------------------------------------------------------------------

    async def _request(self, request: LinkRequest) -> None:
        if self._process is None:
            raise LinkSilentError("the link process is not running; it restarts automatically, then arm")
        await self._process.request(request)

    async def _until(self, wanted: Callable[[], bool], timeout_s: float) -> bool:
        """Whether it comes true in time; looked at after every report."""
        try:
            async with asyncio.timeout(timeout_s):
                while not wanted():
                    await self._changed.wait()
        except TimeoutError:
            return wanted()
        return True

    def _reported_unarmed_since(self, t_asked_ns: int) -> Callable[[], bool]:
        """Whether a health that came after then says that the PLC is heard and not armed."""
        other = (*_ARMED, LinkPhase.OFFLINE)
        return lambda: self._t_health_ns > t_asked_ns and self.health.phase not in other

    def _refuse_if_stopped(self, stops: int, disarms: int) -> None:
        """Arming does not go on past a stop or disarm, nor begin during a disarm; it began with these numbers."""
        if self._disarming or disarms != self._disarms:
            raise LinkRefusedError(
                "the machine was disarmed while it was being armed; arm again when the area is clear"
            )
        if stops != self._stops:
            raise LinkRefusedError("the machine was stopped while it was being armed; arm again when the area is clear")

    def _why_not_disarmed(self) -> LinkError:
        health = self.health
        if health.phase is not LinkPhase.OFFLINE:
            return LinkError(f"disarm: PLC still {health.phase.value} after {_STOP_S:.0f} s; use the local switch")
        return LinkSilentError(
            f"disarm: the PLC did not answer within {_STOP_S:.0f} s ({health.error or 'no state from it'}), so whether "
            "it is disarmed is not known; use the local switch"
        )

    def _why_not_armed(self) -> str:
        health, settings = self.health, self._settings
        where = f"{settings.plc_host}:{settings.plc_port}"
        if health.phase is LinkPhase.OFFLINE:
            reason = health.error or "is it on, are address, port and framing right, and does no other PC hold it?"
            return f"PLC silent: no state from {where}; {reason}"
        if health.phase is LinkPhase.LOCAL:
            return "PLC is in LOCAL: the lever at the machine has control; release the lever, then arm"
        if health.phase is LinkPhase.FAULT:
            bits = self.latest.fault_bits if self.latest else 0
            return f"PLC is in FAULT (bits {bits:#x}): remove the cause and reset, then arm"
        return f"PLC {where} did not arm, link is {health.phase.value}: {health.last_reject or 'no reason given'}"

    def _on_report(self, report: LinkReport) -> None:
        match report:
            case SamplesReport(samples=samples, dropped=dropped):
                self._dropped = dropped
                self._ring.add_samples(samples)
            case HealthReport(health=health, plc_to_pc_offset_ns=offset_ns):
                self._health, self._t_health_ns = replace(health, samples_dropped=self._dropped), mono_ns()
                self._offset_ns = offset_ns if offset_ns is not None else self._offset_ns
            case MotionEnded(traj_id=traj_id):
                if self._motion and not self._motion.done() and traj_id == self._traj_id:
                    self._motion.set_result(report)
            case BindFailed(text=text):
                self._unbound = text
            case TailReport(traj_id=traj_id):
                if self._tail and not self._tail.done() and traj_id == self._traj_id:
                    self._tail.set_result(report)
            case RunRefused(traj_id=traj_id, reason=reason):
                if self._motion and not self._motion.done() and traj_id == self._traj_id:
                    self._motion.set_exception(LinkRefusedError(reason))
        self._changed.set()
        self._changed = asyncio.Event()

    def _on_gone(self, process: SupervisedProcess) -> None:
        """The link process died: whatever moved is stopped by the PLC's watchdog; start a new process."""
        if self._closing or process is not self._process:
            return
        why, self._unbound = self._unbound or "link process died", ""
        _LOG.error("%s; starting a new one in %s s", why, _RESTART_S)
        self._health = replace(self._health, phase=LinkPhase.OFFLINE, error=f"{why}, restarting")
        self._process = None  # `close` in the meantime has nothing left to end
        self._end_motion("the link process died; the PLC ramps to a hold by itself")
        self._restart = asyncio.ensure_future(self._respawn(process))

    async def _respawn(self, dead: SupervisedProcess) -> None:
        try:
            await dead.end_process()
        except Exception:  # whatever is left of it, without a new one nothing is ever commanded again
            _LOG.exception("the resources of the ended link process could not be released")
        while not self._closing:
            await asyncio.sleep(_RESTART_S)
            try:
                return await self._spawn()
            except Exception as error:  # as above: no processes, no files, no threads left, or a defect of ours
                self._health = replace(self._health, error=f"link process could not be started ({error}), trying again")
                _LOG.exception("the link process could not be started; trying again in %s s", _RESTART_S)

    def _end_motion(self, reason: str) -> None:
        if self._motion and not self._motion.done():
            t_plc_ns = self.latest.t_plc_ns if self.latest else 0
            self._motion.set_result(MotionEnded(self._traj_id, False, reason, t_plc_ns))
