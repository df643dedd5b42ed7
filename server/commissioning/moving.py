"""Moving the machine for a step: leave, arming, one guarded motion, rest. Everything that moves goes through here."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from machine.rotations import Array
from recording.clock import mono_ns, mono_s
from server.commissioning.site import Site
from server.link.contracts import LinkPhase, MotionEnded, PlcSample
from server.link.errors import LinkError
from server.link.samples import stood_still
from server.motion.contracts import JointTrajectory, PathPlan
from server.motion.point_to_point import plan_joint_move
from server.motion.settings import PlanSettings

GENTLE_PLAN_SETTINGS = PlanSettings(speed_scale=0.3, duration_min_s=3.0, shape_reference=False)
REST_TIMEOUT_S = 15.0
_REST_WINDOW_S = 0.5
_REST_SPEED_RAD_S = 5e-4  # 2 mm/s at 4 m
_TICK_S = 0.1
_READING_S = 0.1
_FRESH_S = 1.0  # after heavy work of our own the states are there, but not read yet
_ARMED = (LinkPhase.ARMED, LinkPhase.RUNNING, LinkPhase.STOPPING)

Guard = Callable[[PlcSample], str]


class NoLeaveError(Exception):
    """The engineer did not give leave: nothing moves."""


class NotReadyError(Exception):
    """The machine is not in a state in which this step could show anything; the text says what to do."""


@dataclass(frozen=True, slots=True)
class MachineReading:
    """Where the machine is: encoders (a mean over 0.1 s) and reference, (n,) [rad]."""

    q_rad: Array
    q_ref: Array


@dataclass(frozen=True, slots=True)
class PlayedMotion:
    """One motion: its end, the states from its start on, and what the guard objected to (empty: nothing)."""

    motion_end: MotionEnded
    plc_samples: list[PlcSample]
    objection: str


async def require_leave(site: Site, what: str) -> None:
    """Raises NoLeaveError unless the engineer gave leave to move and confirms this motion."""
    if not await site.may_move():
        raise NoLeaveError("no permission to move the machine was given; type its name when asked, or give --move")
    if not await site.operator.confirm(what):
        raise NoLeaveError("the engineer did not confirm the motion")


async def arm_if_needed(site: Site) -> None:
    """Arm, unless it is armed; a person may have to press the enable meanwhile."""
    if site.link.health.phase in _ARMED:
        return
    site.operator.show("arming; press the enable at the machine if it has one")
    await site.link.arm(site.options.arm_timeout_s)


async def read_machine(site: Site) -> MachineReading:
    """Encoders and reference now. Raises: NotReadyError: no fresh state within a second."""

    def fresh() -> list[PlcSample]:
        return site.link.samples_since(mono_ns() - int(_READING_S * 1e9))

    if not await wait_for(site, lambda: bool(fresh()), _FRESH_S, "waiting for a state"):
        raise NotReadyError("no fresh state from the PLC; check the link, then run this step again")
    samples = fresh()
    return MachineReading(np.mean([sample.q_rad for sample in samples], axis=0), np.array(samples[-1].q_ref_rad))


async def wait_for_rest(site: Site, timeout_s: float = REST_TIMEOUT_S) -> MachineReading:
    """Wait until encoders and reference stand still. Raises: NotReadyError: they do not in time."""
    deadline_s = mono_s() + timeout_s
    while mono_s() < deadline_s:
        if at_rest(site.link.samples_since(mono_ns() - int(_REST_WINDOW_S * 1e9))):
            return await read_machine(site)
        await asyncio.sleep(_TICK_S / 2.0)
    raise NotReadyError(f"encoders did not come to rest within {timeout_s:.0f} s; look for a limit cycle or a leak")


def at_rest(samples: list[PlcSample]) -> bool:
    """Whether encoders and reference stood still over at least 80 % of the window."""
    return stood_still(samples, _REST_WINDOW_S, _REST_SPEED_RAD_S, _REST_SPEED_RAD_S)


def gentle_plan(site: Site, q_ref: Array, q_goal: Array, duration_s: float = 3.0) -> PathPlan:
    """A slow, plain joint move of the reference; a status and no trajectory where it may not be driven."""
    return plan_joint_move(site.machine, q_ref, q_goal, replace(GENTLE_PLAN_SETTINGS, duration_min_s=duration_s))


async def run_trajectory(
    site: Site, trajectory: JointTrajectory, text: str, guard: Guard | None = None
) -> PlayedMotion:
    """Run one trajectory and wait for its end. An objection of the guard disarms immediately: valves to neutral.

    Raises: LinkError: refused, or the link is gone. Cancelled: the machine is ramped down first.
    """
    objections: list[str] = []
    disarming: list[asyncio.Task[None]] = []

    def look(sample: PlcSample) -> None:
        objection = guard(sample) if guard is not None and not objections else ""
        if objection:
            objections.append(objection)
            disarming.append(asyncio.ensure_future(_disarm(site)))

    t_start_ns = mono_ns()
    unsubscribe = site.link.on_sample(look)
    running = asyncio.ensure_future(site.link.run(trajectory))
    try:
        await _show_progress(site, running, text, trajectory.duration_s)
    finally:
        unsubscribe()
        if not running.done():
            running.cancel()
            await asyncio.wait({running})
        if disarming:
            await asyncio.wait(disarming)
    return PlayedMotion(running.result(), site.link.samples_since(t_start_ns), objections[0] if objections else "")


async def play_gently(site: Site, q_goal: Array, text: str, guard: Guard | None = None) -> PlayedMotion:
    """A slow joint move of the reference from where it is.

    Raises: NotReadyError: the move is not possible from here.
    """
    plan = gentle_plan(site, (await read_machine(site)).q_ref, q_goal)
    if plan.trajectory is None:
        raise NotReadyError(f"{text}: {plan.reason}")
    return await run_trajectory(site, plan.trajectory, text, guard)


async def _disarm(site: Site) -> None:
    try:
        await site.link.disarm()
    except LinkError as error:
        site.operator.show(f"disarming failed: {error}")


async def _show_progress(site: Site, running: "asyncio.Future[MotionEnded]", text: str, duration_s: float) -> None:
    started_s = mono_s()
    while not running.done():
        site.operator.progress(text, min(mono_s() - started_s, duration_s), duration_s, "s")
        await asyncio.wait({running}, timeout=_TICK_S)


async def wait_shown(site: Site, duration_s: float, text: str) -> None:
    """Let time pass, shown."""
    started_s = mono_s()
    while (elapsed_s := mono_s() - started_s) < duration_s:
        site.operator.progress(text, elapsed_s, duration_s, "s")
        await asyncio.sleep(min(_TICK_S, duration_s - elapsed_s))


async def wait_for(site: Site, wanted: Callable[[], bool], timeout_s: float, text: str) -> bool:
    """Whether it comes true in time; looked at ten times a second."""
    started_s = mono_s()
    while not wanted():
        elapsed_s = mono_s() - started_s
        if elapsed_s >= timeout_s:
            return wanted()
        site.operator.progress(text, elapsed_s, timeout_s, "s")
        await asyncio.sleep(_TICK_S / 2.0)
    return True
