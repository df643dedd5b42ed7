"""Step: the link in a dry run: states, clocks, playback with closed valves, and a PLC that stops by itself."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from machine.description import Machine
from machine.rotations import Array
from protocol.layout import LAYOUT_ID, VERSION_MAJOR
from recording.clock import mono_ns
from server.commissioning.contracts import Figure, StepResult, inconclusive_result, result_of_figures
from server.commissioning.moving import (
    Guard,
    NotReadyError,
    PlayedMotion,
    arm_if_needed,
    gentle_plan,
    read_machine,
    run_trajectory,
    wait_for,
    wait_for_rest,
    wait_shown,
)
from server.commissioning.site import Site
from server.commissioning.stop_figures import stop_figures
from server.commissioning.stopping import EndedByItselfError, StopKind, by_itself, rest_figures, run_and_stop
from server.link.contracts import LinkPhase, PlcSample
from server.motion.contracts import JointTrajectory, evaluate_trajectory

LINK_DRY_RUN_STEP_NAME = "link dry run"
LINK_DRY_RUN_REMEDY = (
    "see docs/plc-link.md for the time limits and reject codes; nothing may be moved before this step passes"
)
DRY_RUN_JOINT_STEP_RAD = math.radians(2.0)
DRY_RUN_MOTION_MAX_RAD = math.radians(0.2)  # further than this in a dry run: the valves are not neutral
ROUND_TRIP_MAX_MS = 50.0
DRY_RUN_DURATION_S = 4.0
SILENCE_RUN_DURATION_S = 6.0
RELINK_TIMEOUT_S = 2.0
_VERSIONS = (f"states are HMLINK {VERSION_MAJOR}, layout {LAYOUT_ID:#010x}; other versions are rejected",)


# How well states arrive, from the samples alone: rate, loss, gaps, delay and the drift of the clocks. Pure.

LOSS_MAX_PCT = 1.0
STATE_GAP_MAX_MS = 250.0  # the link counts as offline then, and a motion would be stopped
ONE_WAY_LATENCY_P99_MAX_MS = 50.0  # a command acknowledges states: the PLC refuses those older than 250 ms
DRIFT_MAX_PPM = 500.0  # usual quartz is below 100; motion does not depend on it, time stamps of pictures do
RATE_TOLERANCE_FRAC = 0.05
_BIN_S = 1.0


def state_figures(samples: Sequence[PlcSample], period_s: float) -> tuple[Figure, ...]:
    """Rate, loss, largest gap, spread of the way from PLC to PC, and clock drift.

    Args:    samples: as received, at least two seconds of them; period_s: of the PLC's states.
    Returns: the figures; NaN where the samples are too few, which is outside every limit.
    """
    rate, lost = 1.0 / period_s, lost_states(samples)
    nan = float("nan")
    if len(samples) < 2:
        return (Figure("states", float(len(samples)), "in all", at_least=2.0),)
    t_pc, t_plc = _pc_and_plc_times(samples)
    span_s = float(t_plc[-1] - t_plc[0])
    way_ms = 1e3 * _delay_above_minimum(t_pc - t_plc)
    return (
        Figure(
            "states on the PLC's clock",
            (len(samples) - 1 + lost) / span_s if span_s > 0.0 else nan,
            "1/s",
            at_least=rate * (1.0 - RATE_TOLERANCE_FRAC),
            at_most=rate * (1.0 + RATE_TOLERANCE_FRAC),
        ),
        Figure("states lost", 100.0 * lost / (len(samples) + lost), "%", None, LOSS_MAX_PCT),
        Figure("largest gap between states", 1e3 * float(np.diff(t_pc).max()), "ms", at_most=STATE_GAP_MAX_MS),
        Figure("latency PLC to PC above the minimum, median", float(np.median(way_ms)), "ms"),
        Figure(
            "latency PLC to PC above the minimum, 99 %",
            float(np.percentile(way_ms, 99)),
            "ms",
            None,
            ONE_WAY_LATENCY_P99_MAX_MS,
        ),
        Figure("drift of the PLC's clock against the PC's", abs(drift_ppm(t_pc, t_plc)), "ppm", at_most=DRIFT_MAX_PPM),
    )


def lost_states(samples: Sequence[PlcSample]) -> int:
    """States missing between the first and the last sample; a new session begins to count again."""
    steps = [after.seq - before.seq for before, after in pairwise(samples)]
    return sum(step - 1 for step in steps if step > 1)


def drift_ppm(t_pc: Array, t_plc: Array) -> float:
    """Rate of t_pc - t_plc [1e-6], from the quickest state of every second: delays only ever add.

    Args:    t_pc, t_plc: (n,) [s].
    Returns: drift; NaN with less than three seconds.
    """
    delay, bins = t_pc - t_plc, ((t_plc - t_plc[0]) // _BIN_S).astype(int)
    best = [np.flatnonzero(bins == number) for number in range(int(bins[-1]) + 1)]
    picked = [rows[np.argmin(delay[rows])] for rows in best if len(rows) >= 10]
    if len(picked) < 3:
        return float("nan")
    return float(np.polyfit(t_plc[picked] - t_plc[0], delay[picked], 1)[0]) * 1e6


def _pc_and_plc_times(samples: Sequence[PlcSample]) -> tuple[Array, Array]:
    """Receive and PLC times from the first sample on (n,) [s]."""
    first = samples[0]
    t_pc = np.array([sample.t_mono_ns - first.t_mono_ns for sample in samples]) * 1e-9
    t_plc = np.array([sample.t_plc_ns - first.t_plc_ns for sample in samples]) * 1e-9
    return t_pc, t_plc


def _delay_above_minimum(delay: Array) -> Array:
    return delay - delay.min()


async def link_dry_run(site: Site) -> StepResult:
    """Listen, then play and fall silent; the latter only where the PLC says that its valves are closed."""
    listened = await _listen(site)
    notes = [*_VERSIONS, *(f"refused: {text}" for text in site.link.health.recent_rejects[-3:])]
    if not site.link.health.dry_run:
        return result_of_figures(
            LINK_DRY_RUN_STEP_NAME,
            listened,
            "",
            LINK_DRY_RUN_REMEDY,
            ["the PLC is not in dry run: playback and silence were not tried; set bDryRun there and run step 1 again"],
            notes=notes,
        )
    if not await site.operator.confirm("a small trajectory is played with closed valves: the machine must not move"):
        return inconclusive_result(
            LINK_DRY_RUN_STEP_NAME, "the engineer did not confirm the dry run", "run step 1 again"
        )
    await arm_if_needed(site)
    played, wanted = await _play_dry_run_motion(site)
    figures = [*listened, *playback_figures(played, wanted, site.machine)]
    if not all(figure.ok for figure in figures):
        return result_of_figures(LINK_DRY_RUN_STEP_NAME, figures, "", LINK_DRY_RUN_REMEDY, notes=notes)
    figures += await _test_silence_stop(site)
    summary = "states arrive in time, knots are played with closed valves, and the PLC stops by itself in silence"
    return result_of_figures(LINK_DRY_RUN_STEP_NAME, figures, summary, LINK_DRY_RUN_REMEDY, notes=notes)


# --- at rest --------------------------------------------------------------------------------------------------------


async def _listen(site: Site) -> list[Figure]:
    before, t_start_ns = site.link.health, mono_ns()
    await wait_shown(site, site.options.listen_s, "listening to the PLC")
    after, samples = site.link.health, site.link.samples_since(t_start_ns)
    return [
        *state_figures(samples, site.machine.plc_log_cycle_s),
        Figure("minimum round trip", after.round_trip_min_ms, "ms", at_most=ROUND_TRIP_MAX_MS),
        Figure("commands sent late by, median", after.lateness_p50_us / 1e3, "ms"),
        Figure("commands sent late by, 99 %", after.lateness_p99_us / 1e3, "ms"),
        Figure("commands refused", float(after.rejected - before.rejected), "commands", at_most=0.0),
    ]


# --- playback -------------------------------------------------------------------------------------------------------


def guard_against_dry_run_movement(q_start: Array) -> Guard:
    """Objects as soon as a joint moves although the PLC says that its valves are closed."""

    def look(sample: PlcSample) -> str:
        moved = float(np.abs(np.array(sample.q_rad) - q_start).max())
        return f"a joint moved by {math.degrees(moved):.2f} deg in a dry run" if moved > DRY_RUN_MOTION_MAX_RAD else ""

    return look


def dry_run_goal(machine: Machine, q_ref: Array) -> Array:
    """Every joint 2 deg towards the middle of its range (n,) [rad]."""
    middle = np.array([(joint.q_min_rad + joint.q_max_rad) / 2.0 for joint in machine.joints])
    return q_ref + np.where(middle >= q_ref, DRY_RUN_JOINT_STEP_RAD, -DRY_RUN_JOINT_STEP_RAD)


async def _plan_small_trajectory(site: Site, q_goal: Array, duration_s: float) -> JointTrajectory:
    plan = gentle_plan(site, (await read_machine(site)).q_ref, q_goal, duration_s)
    if plan.trajectory is None:
        raise NotReadyError(f"no small trajectory is possible from here: {plan.reason}")
    return plan.trajectory


async def _play_dry_run_motion(site: Site) -> tuple[PlayedMotion, JointTrajectory]:
    start = await wait_for_rest(site)
    trajectory = await _plan_small_trajectory(site, dry_run_goal(site.machine, start.q_ref), DRY_RUN_DURATION_S)
    return await run_trajectory(
        site, trajectory, "playing in dry run", guard_against_dry_run_movement(start.q_rad)
    ), trajectory


def playback_figures(played: PlayedMotion, wanted: JointTrajectory, machine: Machine) -> list[Figure]:
    """Whether the reference was played as sent while nothing moved."""
    own = [sample for sample in played.plc_samples if sample.plc_state == "RUN"]
    if not own:
        reason = played.objection or played.motion_end.reason
        return [Figure(f"states of RUN ({reason})", 0.0, "states", at_least=1.0)]
    t_s = np.array([sample.t_play_ns for sample in own]) * 1e-9
    q_ref = np.array([sample.q_ref_rad for sample in own])
    qs = np.array([sample.q_rad for sample in own])
    last = np.array(played.plc_samples[-1].q_ref_rad)
    off_path = math.degrees(float(np.abs(q_ref - evaluate_trajectory(wanted, t_s).q).max()))
    off_goal = math.degrees(float(np.abs(last - wanted.q[-1]).max()))
    ended = f"trajectory ended early ({played.objection or played.motion_end.reason})"
    return [
        Figure(ended, 0.0 if played.motion_end.reached and not played.objection else 1.0, "times", at_most=0.0),
        Figure("reference off its path", off_path, "deg", None, 1e-6),
        Figure("reference off its goal", off_goal, "deg", None, 1e-6),
        Figure("encoders moved", math.degrees(float(np.ptp(qs, axis=0).max())), "deg",
            at_most=math.degrees(DRY_RUN_MOTION_MAX_RAD)),
        Figure("largest valve command", max(abs(v) for s in own for v in s.valve_frac), "of full", at_most=0.0),
        Figure("knot buffer underruns", float(own[-1].underruns - own[0].underruns), "times", at_most=0.0),
    ]  # fmt: skip


# --- silence --------------------------------------------------------------------------------------------------------


async def _test_silence_stop(site: Site) -> list[Figure]:
    """Fall silent in the middle of a trajectory and watch."""
    start = await wait_for_rest(site)
    trajectory = await _plan_small_trajectory(site, dry_run_goal(site.machine, start.q_ref), SILENCE_RUN_DURATION_S)
    text = "playing in dry run, then silence"
    try:
        stopped = await run_and_stop(
            site, trajectory, StopKind.SILENCE, text, guard=guard_against_dry_run_movement(start.q_rad)
        )
    except EndedByItselfError as error:
        return [by_itself("silence", error)]
    stop = stop_figures(stopped.plc_samples, stopped.t_trigger_plc_ns, site.machine)
    back = await wait_for(
        site, lambda: site.link.health.phase is LinkPhase.LINKED, RELINK_TIMEOUT_S, "waiting for the link"
    )
    figures = [*rest_figures("silence", StopKind.SILENCE, stop), *closed_figures(stopped.plc_samples, start.q_rad)]
    return [*figures, Figure("new session within 2 s of sending again", float(back), "(1: yes)", at_least=1.0)]


def closed_figures(samples: Sequence[PlcSample], q_start: Array) -> list[Figure]:
    """Whether the valves stayed closed without commands: nothing moved, from the motion's start to the end."""
    moved_rad = max((float(np.abs(np.array(sample.q_rad) - q_start).max()) for sample in samples), default=math.nan)
    valve = max((abs(v) for sample in samples for v in sample.valve_frac), default=math.nan)
    return [
        Figure("silence: encoders moved", math.degrees(moved_rad), "deg", at_most=math.degrees(DRY_RUN_MOTION_MAX_RAD)),
        Figure("silence: largest valve command", valve, "of full", at_most=0.0),
    ]
