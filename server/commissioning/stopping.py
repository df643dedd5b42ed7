"""Stopping a motion on purpose, in the three ways in which it may be stopped, while watching."""

import asyncio
from dataclasses import dataclass
from enum import Enum

from protocol.timeouts import COMMAND_LOST_TIMEOUT, COMMAND_PERIOD, SESSION_TIMEOUT, STATE_PERIOD
from recording.clock import mono_ns
from server.commissioning.contracts import Figure
from server.commissioning.moving import Guard, NotReadyError, run_trajectory, wait_for, wait_shown
from server.commissioning.site import Site
from server.commissioning.stop_figures import StopFigures
from server.link.contracts import PlcSample
from server.motion.contracts import JointTrajectory

LINK_SILENCE_DURATION_S = 1.8
_AFTER_STOP_S = 2.5  # a boom of this size has stopped swinging visibly
_STATE_MS = STATE_PERIOD.duration_ns / 1e6
SILENCE_REACTION_MAX_MS = (
    COMMAND_LOST_TIMEOUT.duration_ns / 1e6 + 2.0 * _STATE_MS
)  # 260 ms, and the ramp is seen at the next state
STOP_REACTION_MAX_MS = 100.0  # one command period, the way there, one state; on a PC that is busy
RAMP_SLACK_MS = 2.0 * _STATE_MS  # begin and end are each seen at the next state
SESSION_VOID_TIME_MIN_MS = (
    SESSION_TIMEOUT.duration_ns - COMMAND_PERIOD.duration_ns
) / 1e6 - _STATE_MS  # counts from the last command, before we asked
SESSION_VOID_TIME_MAX_MS = SESSION_TIMEOUT.duration_ns / 1e6 + 5.0 * _STATE_MS


class StopKind(Enum):
    """What ends the motion."""

    STOP = "STOP"
    QUICK_STOP = "QUICK_STOP"
    SILENCE = "silence"

    @property
    def reaction_max_ms(self) -> float:
        """Longest time from asking to the ramp's begin."""
        return SILENCE_REACTION_MAX_MS if self is StopKind.SILENCE else STOP_REACTION_MAX_MS


class EndedByItselfError(NotReadyError):
    """The motion ended before it was stopped: the text says how."""


@dataclass(frozen=True, slots=True)
class StopRun:
    """The states from the motion's start to standstill, when the stop was requested, and a guard's objection."""

    plc_samples: list[PlcSample]
    t_trigger_plc_ns: int
    objection: str


async def run_and_stop(
    site: Site, trajectory: JointTrajectory, kind: StopKind, text: str, share: float = 0.5, guard: Guard | None = None
) -> StopRun:
    """Play, stop at a share of the duration, and wait for standstill (and in silence for the session's end).

    Raises: EndedByItselfError: it never came to that share.
    """
    t_start_ns = mono_ns()
    trigger = asyncio.ensure_future(_trigger_stop(site, trajectory.duration_s * share, kind, text))
    try:
        played = await run_trajectory(site, trajectory, text, guard)
        try:
            async with asyncio.timeout(LINK_SILENCE_DURATION_S):
                t_trigger_ns = await trigger
        except TimeoutError:
            raise EndedByItselfError(played.objection or played.motion_end.reason or "it had reached its end") from None
    finally:
        trigger.cancel()
    await wait_shown(
        site,
        LINK_SILENCE_DURATION_S if kind is StopKind.SILENCE else _AFTER_STOP_S,
        f"{text}: watching it come to rest",
    )
    return StopRun(site.link.samples_since(t_start_ns), t_trigger_ns, played.objection)


async def _trigger_stop(site: Site, t_play_s: float, kind: StopKind, text: str) -> int:
    """Wait for the moment and stop; the moment on the PLC's clock [ns]."""

    def there() -> bool:
        latest = site.link.latest
        return latest is not None and latest.plc_state == "RUN" and latest.t_play_ns >= t_play_s * 1e9

    await wait_for(site, there, t_play_s + 3.0, text)
    offset_ns, t_asked_ns = site.link.plc_to_pc_offset_ns or 0, mono_ns()
    if kind is StopKind.SILENCE:
        await site.link.go_silent(LINK_SILENCE_DURATION_S)
    elif kind is StopKind.QUICK_STOP:
        await site.link.quick_stop("commissioning: stop times")
    else:
        await site.link.stop("commissioning: stop times")
    return t_asked_ns - offset_ns


def by_itself(name: str, error: EndedByItselfError) -> Figure:
    """A failure: what was to be stopped had ended already."""
    return Figure(f"{name}: motion ended before it was stopped ({error})", 1.0, "times", at_most=0.0)


def rest_figures(name: str, kind: StopKind, stop: StopFigures) -> list[Figure]:
    """Reaction, ramp and (in silence) the session's end, against their limits."""
    figures = [
        Figure(f"{name}: ramp begins after", stop.reaction_ms, "ms", at_most=kind.reaction_max_ms),
        Figure(f"{name}: ramp", stop.ramp_ms, "ms", at_most=stop.ramp_bound_ms + RAMP_SLACK_MS),
        Figure(f"{name}: motion resumed", float(stop.resumed), "times", at_most=0.0),
        Figure(f"{name}: ended by a fault or the lever", float(stop.faulted), "times", at_most=0.0),
    ]
    if kind is StopKind.SILENCE:
        figures.append(
            Figure(
                f"{name}: session void after", stop.void_ms, "ms", SESSION_VOID_TIME_MIN_MS, SESSION_VOID_TIME_MAX_MS
            )
        )
    return figures
