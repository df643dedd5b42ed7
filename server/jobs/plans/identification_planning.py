"""The identification drive, planned whole: motions about the present posture, then looks from a dozen postures."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from machine.kinematics import tcp_poses
from server.calibration.contracts import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.plans.drive_steps import (
    Step,
    clearance_of,
    drive_settings,
    refuse_unsafe_reference,
    steps_hash,
    way_to,
)
from server.jobs.records import DriveSegment, IdentificationPlan
from server.motion.approach import play_of
from server.motion.contracts import JointTrajectory, join_trajectories
from server.motion.identification_courses import PARTS, MotionPart, fitted_course, part_course, part_marks
from server.motion.identification_postures import Postures, SeenObject, choose_postures
from server.motion.refusal import Refusal
from server.motion.timing import tcp_speed

LOOKS_PART_NAME = "looks"
LOOKS_SHOWN_QUANTITIES = ("zeros", "lengths", "sag", "camera's mount", "backlash", "lens")
POSTURES, POSTURES_MIN = 12, 6
N_TWO_SIDED_POSTURES = 3  # postures that are come to from above as well: what differs is the play
LOOK_DURATION_S = 3.0  # to come to rest and look, without the way
# Of what was not known before: a number that the looks leave as open as that is not shown by them
UNRESOLVED_SIGMA_MIN_FRAC = 0.6
MOTION_SIZE_FACTORS = (1.0, 0.6, 0.35)
PART_DURATION_MIN_S = 4.0


@dataclass(frozen=True, slots=True)
class PlannedPart:
    """One part: motions from rest to rest, in the order in which they are driven."""

    drive_segment: DriveSegment
    steps: tuple[Step, ...]

    @property
    def name(self) -> str:
        """As in the recording."""
        return self.drive_segment.name


@dataclass(frozen=True, slots=True)
class PlannedIdentification:
    """A whole drive, known by its hash, from the reference that it begins at."""

    parts: tuple[PlannedPart, ...]
    impossible_parts: tuple[str, ...]
    plan_hash: str
    q_ref_start: Array
    t_made_ns: int
    expires_ns: int

    @property
    def trajectories(self) -> list[JointTrajectory]:
        """All motions in their order."""
        return [step.trajectory for part in self.parts for step in part.steps]

    @property
    def duration_s(self) -> float:
        """Of all motion and looks [s]."""
        return sum(part.drive_segment.duration_s for part in self.parts)


@dataclass(slots=True)
class Drive:
    """What a drive is made of, before it is planned: kept between its jobs, so that the rest of it can be planned.

    `q_home`: where the motions begin and end; `seen_object`: the object to look at, None without one.
    """

    q_home: Array
    seen_object: SeenObject | None
    duration_scale: float
    done_parts: set[str] = field(default_factory=set)


def planned_drive(ctx: PlanContext, drive: Drive, q_ref: Array, t_now_ns: int) -> PlannedIdentification:
    """Every part of a drive that is not done yet, from the present reference. Nothing moves.

    A part that is not possible here is left out, and the plan says why.
    Raises: JobFailedError: nothing at all is possible here.
    """
    parts: list[PlannedPart] = []
    cannot: list[str] = []
    here = np.asarray(q_ref, dtype=float)
    for part in (part for part in PARTS if part.name not in drive.done_parts):
        try:
            planned = _motion_part(
                ctx, replace(part, duration_s=_scaled_duration_s(part, drive.duration_scale)), here, drive.q_home
            )
        except JobFailedError as error:
            cannot.append(f"{part.name} is left out, so {', '.join(part.effects_shown)} may stay open: {error}")
            continue
        parts.append(planned)
        here = drive.q_home
    if LOOKS_PART_NAME not in drive.done_parts:
        looks, why = _looks_part(ctx, drive, here)
        parts += [looks] if looks else []
        cannot += why
    if not parts:
        raise JobFailedError(f"identify: nothing can be driven from here: {'; '.join(cannot)}", "identify_nothing")
    expires_ns = t_now_ns + int(ctx.settings.position.plan_expires_s * 1e9)
    steps = tuple(step for part in parts for step in part.steps)
    start = np.asarray(q_ref, dtype=float)
    return PlannedIdentification(tuple(parts), tuple(cannot), steps_hash(steps), start, t_now_ns, expires_ns)


def _scaled_duration_s(part: MotionPart, share: float) -> float:
    return max(PART_DURATION_MIN_S, share * part.duration_s)


def _motion_part(ctx: PlanContext, part: MotionPart, here: Array, q_home: Array) -> PlannedPart:
    """A motion as large as the room allows. Raises: JobFailedError: none is possible, with the last reason."""
    settings = drive_settings(ctx)
    course = part_course(ctx.machine, ctx.chain, part, q_home, settings)
    refused: JobFailedError | None = None
    for size in MOTION_SIZE_FACTORS:
        smaller = replace(course, q=q_home + size * (course.q - q_home))
        fitted = fitted_course(ctx.machine, ctx.chain, smaller, settings)
        if isinstance(fitted, Refusal):
            refused = JobFailedError(fitted.reason, f"plan_{fitted.status.value}")
            continue
        try:
            refuse_unsafe_reference(ctx, fitted)
            way = way_to(ctx, here, q_home, "to where the motions begin")
        except JobFailedError as error:
            refused = error
            continue
        step = Step(fitted, part.name, segment_marks=part_marks(part))
        summary = DriveSegment(part.name, _total_duration_s((*way, step)), part.effects_shown, _reduced_size_note(size))
        return PlannedPart(summary, (*way, step))
    raise refused or JobFailedError("no size of it fits", "plan_too_fast")


def _reduced_size_note(size: float) -> str:
    return "" if size == 1.0 else f"{100 * size:.0f} % of its size, to fit the free space: it identifies less"


def _looks_part(ctx: PlanContext, drive: Drive, here: Array) -> tuple[PlannedPart | None, list[str]]:
    if drive.seen_object is None:
        text = "no marker of the object is visible, so no look is possible: zeros, lengths, sag and mount stay open"
        return None, [f"{text}; begin where the camera sees it"]
    count = max(POSTURES_MIN, round(POSTURES * min(1.0, drive.duration_scale / 0.66)))
    margin_rad = drive_settings(ctx).joint_margin_rad + float(play_of(ctx.chain.n).max())
    found = choose_postures(ctx.machine, ctx.chain, drive.q_home, drive.seen_object, ctx.wall, count, margin_rad)
    steps, dropped = _look_steps(ctx, found.q, here)
    looked = sum(step.follow_up == "look" for step in steps)
    if not looked:
        return None, [f"no posture can be looked from: of {found.in_view} with a marker in view none can be reached"]
    back = way_to(ctx, steps[-1].trajectory.q[-1], drive.q_home, "back to where the drive began")
    why = [dropped] if dropped else []
    why += _stay_open(found)
    summary = DriveSegment(LOOKS_PART_NAME, _total_duration_s((*steps, *back)), LOOKS_SHOWN_QUANTITIES, dropped)
    return PlannedPart(summary, (*steps, *back)), why


def _look_steps(ctx: PlanContext, postures: Array, here: Array) -> tuple[tuple[Step, ...], str]:
    """To each posture (k, n) from below in every joint, and to some from above as well; what cannot be reached."""
    play = play_of(ctx.chain.n)
    steps: list[Step] = []
    reasons: list[str] = []
    for number, posture in enumerate(postures, start=1):
        sides = (-1.0, 1.0) if number % (len(postures) // N_TWO_SIDED_POSTURES or 1) == 0 else (-1.0,)
        for side in sides:
            purpose = f"posture {number} of {len(postures)}, from {'below' if side < 0.0 else 'above'}"
            try:
                before = posture + side * play
                legs = [*way_to(ctx, here, before, purpose), *way_to(ctx, before, posture, purpose)]
            except JobFailedError as error:
                reasons.append(str(error))
                continue
            steps.append(Step(join_trajectories([leg.trajectory for leg in legs]), purpose, "look"))
            here = posture
    note = f"{len(reasons)} of the looks are left out: {reasons[0]}" if reasons else ""
    return tuple(steps), note


def _stay_open(found: Postures) -> list[str]:
    """Numbers that looks from these postures leave about as open as they were."""
    left = [
        _parameter_label(name, joint)
        for name, joint, ratio in found.parameter_sigma_ratios
        if ratio > UNRESOLVED_SIGMA_MIN_FRAC
    ]
    return (
        [f"the looks cannot separate {', '.join(dict.fromkeys(left))} from where object and camera are"] if left else []
    )


def _parameter_label(name: str, joint: int | None) -> str:
    return name if joint is None else f"{name} of joint {joint}"


def _total_duration_s(steps: Iterable[Step]) -> float:
    return round(
        sum(step.trajectory.duration_s + (LOOK_DURATION_S if step.follow_up == "look" else 0.5) for step in steps), 1
    )


def plan_summary(ctx: PlanContext, planned: PlannedIdentification, t_now_ns: int) -> IdentificationPlan:
    """A planned drive as the operator checks it."""
    trajectories = planned.trajectories
    clearance = min(clearance_of(ctx, motion) for motion in trajectories)
    travel = sum((np.abs(np.diff(motion.q, axis=0)).sum(axis=0) for motion in trajectories), np.zeros(ctx.chain.n))
    whole = join_trajectories(trajectories)
    path = tcp_poses(ctx.chain, whole.q[:: max(1, len(whole.q) // 200)])[:, :3, 3]
    caution = "no wall is known: clearance was not checked, watch the whole path" if ctx.wall is None else ""
    return IdentificationPlan(
        plan_hash=planned.plan_hash,
        expires_in_s=round((planned.expires_ns - t_now_ns) * 1e-9, 1),
        duration_s=round(planned.duration_s, 1),
        parts=tuple(part.drive_segment for part in planned.parts),
        cannot=planned.impossible_parts,
        looks=sum(step.follow_up == "look" for part in planned.parts for step in part.steps),
        tcp_speed_max_mm_s=round(max(tcp_speed(ctx.chain, motion) for motion in trajectories) * 1e3, 1),
        clearance_mm=round(clearance * 1e3, 1) if np.isfinite(clearance) else None,
        joint_travel_deg=tuple(round(float(value), 1) for value in np.rad2deg(travel)),
        tcp_path_m=tuple((round(float(x), 3), round(float(y), 3), round(float(z), 3)) for x, y, z in path),
        caution=caution,
    )
