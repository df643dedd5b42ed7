"""The check list: its order, what each step needs before it, and how it is gone through."""

import math
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from protocol.limits import LimitTable, cfg_id, limits_of
from recording.clock import mono_s
from server.camera.client import REPORT_SILENCE_MAX_S
from server.camera.errors import CameraError
from server.commissioning.camera_axes import camera_axes
from server.commissioning.contracts import (
    Figure,
    ReportTable,
    StepResult,
    Verdict,
    inconclusive_result,
    result_of_figures,
    skipped_result,
    still_counts,
)
from server.commissioning.joint_ranges import joint_ranges
from server.commissioning.joint_signs import joint_signs
from server.commissioning.link_dry_run import link_dry_run
from server.commissioning.moving import MachineReading, NoLeaveError, NotReadyError, read_machine, wait_for
from server.commissioning.site import Site
from server.commissioning.stop_times import stop_times
from server.commissioning.tool_marker import tool_marker
from server.link.contracts import LinkPhase
from server.link.errors import LinkError

PLC_WAIT_S = 4.0
CAMERA_WAIT_S = 20.0  # the first pair may compile
DRY_RUN_WAIT_S = 5.0
ONE_CONTROLLER_REMEDY = (
    "is a server running, here or elsewhere? one controller at a time: the PLC answers only to the first"
)


# Step: every encoder says what is read at the machine itself (scale, mark or inclinometer).

ENCODER_ZEROS_STEP_NAME = "encoder zeros"
ENCODER_ZEROS_REMEDY = "set the encoder's offset in the PLC so that it agrees with the mark, then run this step again"


async def encoder_zeros(site: Site) -> StepResult:
    """Ask for the angle of every joint as read at the machine; the encoder's value is shown only afterwards."""
    site.operator.show("put every joint on a known mark, or read its angle at the machine; leave empty what you cannot")
    seen_deg: list[float | None] = []
    for joint in site.machine.joints:
        bounds = f"{math.degrees(joint.q_min_rad):.0f} .. {math.degrees(joint.q_max_rad):.0f}"
        question = f"{joint.name}: angle read at the machine [deg, {bounds}; empty: not read]"
        seen_deg.append(await _ask_angle(site, f"encoder_zeros.{joint.name}", question))
    names = [joint.name for joint in site.machine.joints]
    return compare_zeros(names, await read_machine(site), seen_deg, site.options.zero_tolerance_deg)


async def _ask_angle(site: Site, key: str, question: str) -> float | None:
    """A number, requested again until it is one; None without an answer."""
    for _ in range(3):
        answer = await site.operator.ask(key, question)
        if answer is None or not answer.strip():
            return None
        try:
            value = float(answer)
        except ValueError:
            value = math.nan
        if math.isfinite(value):
            return value
        site.operator.show(f"'{answer}' is not a number; give degrees, such as 12.5")
    return None


def compare_zeros(
    names: list[str], reading_now: MachineReading, seen_deg: list[float | None], tolerance_deg: float
) -> StepResult:
    """The result for what was read at the machine; None: not read."""
    q_deg = [math.degrees(value) for value in reading_now.q_rad]
    pairs = list(zip(names, q_deg, seen_deg, strict=True))
    figures = [
        Figure(f"{name}: encoder against the mark", abs(q - seen), "deg", at_most=tolerance_deg)
        for name, q, seen in pairs
        if seen is not None
    ]
    unread = [name for name, _, seen in pairs if seen is None]
    rows = tuple((name, f"{q:+.3f}", "" if seen is None else f"{seen:+.3f}") for name, q, seen in pairs)
    table = ReportTable("angles", ("joint", "encoder deg", "read at the machine deg"), rows)
    if not figures:
        skip = skipped_result(
            ENCODER_ZEROS_STEP_NAME, "no angle was read at the machine", "read them, or give them in --answers"
        )
        return StepResult(ENCODER_ZEROS_STEP_NAME, Verdict.SKIPPED, skip.summary, remedy=skip.remedy, tables=(table,))
    missing = [f"not read at the machine: {', '.join(unread)}"] if unread else []
    summary = f"all encoders within {tolerance_deg:g} deg of their marks"
    return result_of_figures(ENCODER_ZEROS_STEP_NAME, figures, summary, ENCODER_ZEROS_REMEDY, missing, tables=(table,))


# Step: both ends hold the same limits, by their hash.

LIMITS_EQUAL_STEP_NAME = "limits equal"
_COLUMNS = (("Q_MIN", "q_min"), ("Q_MAX", "q_max"), ("QD_MAX", "qd_max"), ("QDD_MAX", "qdd_max"))


async def limits_equal(site: Site) -> StepResult:
    """Compare the PLC's cfg_id with ours; on a difference show our table to compare with GVL_HmMachine."""
    table, theirs = limits_of(site.machine.joints), site.link.health.cfg_id
    return compare_limits(table, theirs)


def compare_limits(table: LimitTable, plc_cfg_id: int) -> StepResult:
    """The result for our table and the PLC's hash; 0: the PLC reported none."""
    ours = cfg_id(table)
    if plc_cfg_id == 0:
        return inconclusive_result(
            LIMITS_EQUAL_STEP_NAME,
            "the PLC reported no cfg_id (0)",
            "let the PLC compute it at start-up (FB_HmSelfCheck)",
        )
    if plc_cfg_id == ours:
        return StepResult(LIMITS_EQUAL_STEP_NAME, Verdict.PASS, f"cfg_id {ours:#010x} on both ends")
    return StepResult(
        LIMITS_EQUAL_STEP_NAME,
        Verdict.FAIL,
        f"cfg_id of the PLC {plc_cfg_id:#010x}, ours {ours:#010x}: the limits differ, and the PLC refuses HELLO",
        remedy="compare the table with GVL_HmMachine; the machine file is the source: export again and load it",
        tables=(limits_table(table),),
    )


def limits_table(table: LimitTable) -> ReportTable:
    """Our limits with the names that GVL_HmMachine has for them."""
    rows = [
        (
            axis.name,
            *(f"{getattr(axis, field)!r} ({math.degrees(getattr(axis, field)):.6g} deg)" for _, field in _COLUMNS),
        )
        for axis in table.axes
    ]
    shared = f"{table.spacing_min_ns} .. {table.spacing_max_ns} ns, start tolerance {table.start_tolerance_rad!r} rad"
    return ReportTable(f"our limits [rad, s]; knots {shared}", ("axis", *(name for name, _ in _COLUMNS)), tuple(rows))


class StepRequirement(Enum):
    """What must be there before a step begins."""

    PLC = "states from the PLC"
    VALVES = "a PLC that is not in dry run"
    LEAVE = "permission to move"
    CAMERA = "images from the camera"


@dataclass(frozen=True, slots=True)
class Step:
    """One line of the list. `prerequisite_steps`: those whose failure makes this one pointless or dangerous."""

    number: int
    name: str
    run: Callable[[Site], Awaitable[StepResult]]
    requirements: tuple[StepRequirement, ...]
    prerequisite_steps: tuple[int, ...] = ()


_MOVES = (StepRequirement.PLC, StepRequirement.VALVES, StepRequirement.LEAVE)
CHECK_LIST_STEPS = (
    Step(1, "link dry run", link_dry_run, (StepRequirement.PLC,)),
    Step(2, "limits equal", limits_equal, (StepRequirement.PLC,)),
    Step(3, "encoder zeros", encoder_zeros, (StepRequirement.PLC,)),
    Step(4, "joint ranges", joint_ranges, (StepRequirement.PLC,)),
    Step(5, "joint signs", joint_signs, _MOVES, prerequisite_steps=(1, 2, 4)),
    Step(6, "camera axes", camera_axes, (*_MOVES, StepRequirement.CAMERA), prerequisite_steps=(1, 2, 3, 4, 5)),
    Step(7, "tool marker", tool_marker, (StepRequirement.CAMERA,)),
    Step(8, "stop times", stop_times, _MOVES, prerequisite_steps=(1, 2, 3, 4, 5)),
)


async def go_through(
    site: Site, steps: Sequence[Step], earlier: Sequence[StepResult], done: Callable[[StepResult], None]
) -> list[StepResult]:
    """Every step in order; `done` gets each result. The machine is disarmed after every step.

    Args:    earlier: results of a report that this run goes on from; their failures count for what comes after.
    """
    results = {result.name: result for result in earlier}
    fresh: list[StepResult] = []
    for step in steps:
        site.operator.show(f"step {step.number}: {step.name}")
        started_s = mono_s()
        result = await _run_one_step(site, step, results)
        result = replace(result, duration_s=mono_s() - started_s)
        earlier_one = results.get(step.name)
        results[step.name] = earlier_one if earlier_one is not None and still_counts(earlier_one, result) else result
        fresh.append(result)
        done(result)
    return fresh


async def _run_one_step(site: Site, step: Step, results: dict[str, StepResult]) -> StepResult:
    try:
        refusal = await _step_refusal(site, step, results)
        if refusal is not None:
            return refusal
        result = await step.run(site)
        return replace(result, notes=(*result.notes, *_unproven_step_notes(step, results)))
    except NoLeaveError as error:
        return skipped_result(step.name, str(error), "give permission when the area is clear, and run this step again")
    except (LinkError, CameraError, NotReadyError, ValueError) as error:
        return inconclusive_result(step.name, str(error), "remove the cause and run this step again")
    finally:
        await _leave_at_rest(site)


async def _leave_at_rest(site: Site) -> None:
    """Disarm: between steps nothing can move the machine but its own lever."""
    try:
        await site.link.disarm()
    except LinkError as error:
        site.operator.show(f"disarming failed: {error}")


async def _step_refusal(site: Site, step: Step, results: dict[str, StepResult]) -> StepResult | None:
    """Why a step cannot begin, or None."""
    failed = [
        s.name for s in CHECK_LIST_STEPS if s.number in step.prerequisite_steps and _has_failed(results.get(s.name))
    ]
    if failed:
        return inconclusive_result(step.name, f"not started, because '{failed[0]}' failed", f"fix '{failed[0]}' first")
    for need in step.requirements:
        refusal = await _NEEDS[need](site, step.name)
        if refusal is not None:
            return refusal
    if StepRequirement.LEAVE in step.requirements:
        return _need_proof(site, step.name, results.get(CHECK_LIST_STEPS[0].name))
    return None


def _unproven_step_notes(step: Step, results: dict[str, StepResult]) -> list[str]:
    """What should have passed before, and was not even tried or stayed open."""
    notes = []
    for before in (each for each in CHECK_LIST_STEPS if each.number in step.prerequisite_steps):
        result = results.get(before.name)
        if result is None or result.verdict is not Verdict.PASS:
            notes.append(f"'{before.name}' before it: {'not run' if result is None else result.verdict.value}")
    return notes


def _has_failed(result: StepResult | None) -> bool:
    return result is not None and result.verdict is Verdict.FAIL


async def _need_plc(site: Site, name: str) -> StepResult | None:
    phase_known = await wait_for(site, lambda: site.link.health.phase is not LinkPhase.OFFLINE, PLC_WAIT_S, "PLC")
    if phase_known:
        return None
    health, plc = site.link.health, site.settings.plc
    problem = health.error or health.last_reject or "check cable, address, port and framing"
    why = f"no state from the PLC at {plc.host}:{plc.port}; {problem}"
    return inconclusive_result(name, why, ONE_CONTROLLER_REMEDY)


async def _need_valves(site: Site, name: str) -> StepResult | None:
    if not site.link.health.dry_run:
        return None
    if await site.operator.confirm("end the dry run at the PLC now (bDryRun := FALSE); the machine will move later"):
        await wait_for(site, lambda: not site.link.health.dry_run, DRY_RUN_WAIT_S, "waiting for the end of the dry run")
    if not site.link.health.dry_run:
        return None
    remedy = "set bDryRun FALSE, then run this step again"
    return inconclusive_result(name, "the PLC is in dry run: nothing would move", remedy)


def _need_proof(site: Site, name: str, dry_run: StepResult | None) -> StepResult | None:
    """A real machine is not moved over a link that was never seen to stop by itself."""
    latest = site.link.latest
    simulated = latest is not None and latest.simulation
    if simulated or (dry_run is not None and dry_run.verdict is Verdict.PASS):
        return None
    why = "step 1 (link dry run) has not passed: it is not proven that this PLC stops by itself"
    return inconclusive_result(name, why, "run step 1 in dry run first; --resume continues its report")


async def _need_leave(site: Site, name: str) -> StepResult | None:
    if await site.may_move():
        return None
    return skipped_result(
        name, "no permission to move the machine was given", "type the machine's name when asked, or give --move"
    )


async def _need_camera(site: Site, name: str) -> StepResult | None:
    vision = site.vision
    if vision is None:
        return inconclusive_result(
            name, "no camera was started", "run the steps that look with a camera in the settings"
        )
    if await wait_for(site, lambda: vision.age_s < REPORT_SILENCE_MAX_S, CAMERA_WAIT_S, "waiting for images"):
        return None
    return inconclusive_result(
        name, f"no images: {vision.stream_text or 'camera is silent'}", "check the camera's settings"
    )


_NEEDS = {
    StepRequirement.PLC: _need_plc,
    StepRequirement.VALVES: _need_valves,
    StepRequirement.LEAVE: _need_leave,
    StepRequirement.CAMERA: _need_camera,
}
