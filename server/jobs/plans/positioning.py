"""The whole loop: look, orient, approach, calibrate, then look-then-move until inside the tolerance."""

from collections.abc import Callable, Generator

from recording.clock import mono_ns
from server.calibration.calibration_life import ValidityStatus
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.approaching import approach, approach_pose, goal_pose
from server.jobs.plans.assurance import assured_preview
from server.jobs.plans.calibrating import calibrate, possible_path
from server.jobs.plans.living import calibration_validity, require_valid, validity_at
from server.jobs.plans.looking import good_look, ooi_in_base
from server.jobs.plans.moving import execute
from server.jobs.plans.orienting import ORIENTATION_ERROR_OK_DEG, orient
from server.jobs.plans.seeing import refuted_inputs
from server.jobs.plans.tolerance import error_of, is_look_inside_tolerance
from server.jobs.records import CalibrationRecord, PositionResult
from server.jobs.requests import Progress, Request

Clock = Callable[[], int]


def position(
    ctx: PlanContext, recalibrate: bool, clock_ns: Clock = mono_ns
) -> Generator[Request, object, PositionResult]:
    """Bring the tool to the goal. Ends reached, or not reached with the reason; a failed look fails the job.

    A tool that is inside already stays where it is. What was known of the run before is forgotten when this one begins,
    not when it is refused: the way back and the calibration outlive a job that moved nothing.
    """
    watch = _StopWatch(clock_ns)
    taken = first = yield from good_look(ctx)
    watch.record_lap_time("look")
    if is_look_inside_tolerance(ctx, taken):
        ctx.knowledge.moves.clear()
        return _position_result(ctx, first, taken, ctx.knowledge.calibration_record, watch)
    if not recalibrate:
        yield from _drop_expired(ctx, taken)
    elif error_of(taken).rotation_deg < ORIENTATION_ERROR_OK_DEG and approach_pose(ctx, taken) is None:
        possible_path(ctx, taken.reading)  # it will be driven from here
    _begin_run(ctx, taken, recalibrate)
    taken = yield from orient(ctx, taken)
    watch.record_lap_time("orient")
    if ctx.knowledge.mount_rotation_estimate is None:
        near = yield from approach(ctx, taken)
        if near is not taken:
            watch.record_lap_time("approach")
        taken = near
        yield from calibrate(ctx, taken)
        watch.record_lap_time("calibrate")
        taken = yield from good_look(ctx)
        watch.record_lap_time("look after calibration")
    taken = yield from _move_until_inside(ctx, taken, watch, clock_ns)
    return _position_result(ctx, first, taken, ctx.knowledge.calibration_record, watch)


def _begin_run(ctx: PlanContext, taken: LookTaken, recalibrate: bool) -> None:
    """Only this look is known from now on: the object of interest may be another one than before."""
    ctx.knowledge.q_start = taken.reading.q_rad
    ctx.knowledge.moves.clear()
    fresh = ctx.knowledge.look_observations[-1:]
    if recalibrate:
        ctx.knowledge.forget_calibration()
    ctx.knowledge.look_observations[:], ctx.knowledge.joint_estimate = fresh, None
    ctx.knowledge.T_base_ooi = ooi_in_base(ctx, taken)  # by what is still known of the mount


def _drop_expired(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, None]:
    """A kept calibration that does not hold here or at the goal is made again; after a slip a person looks first."""
    found = calibration_validity(ctx, taken.reading)
    if found.status is ValidityStatus.SLIPPED:
        require_valid(found, "calibration")
    if found.ok:
        found = validity_at(ctx, taken.reading, taken.reading.q_rad, goal_pose(ctx, taken))
    if not found.ok:
        yield Progress("calibrate", 0.0, 1.0, "", f"calibrating again: {found.reason}")
        ctx.knowledge.forget_calibration()


def _move_until_inside(
    ctx: PlanContext, taken: LookTaken, watch: "_StopWatch", clock_ns: Clock
) -> Generator[Request, object, LookTaken]:
    goal = ctx.settings.position
    for number in range(1, goal.moves_max + 1):
        if is_look_inside_tolerance(ctx, taken):
            break
        assured = yield from assured_preview(ctx, taken, clock_ns(), goal.moves_max - number)
        if assured.n_calibration_paths:
            watch.record_lap_time("calibrate again")
        taken = yield from execute(ctx, assured.previewed_plan, number)
        watch.record_lap_time(f"move {number}")
        error = error_of(taken)
        yield Progress("error", error.distance_mm, goal.tolerance_mm, "mm", f"after move {number}")
    return taken


def _position_result(
    ctx: PlanContext, first: LookTaken, last: LookTaken, calibration: CalibrationRecord | None, watch: "_StopWatch"
) -> PositionResult:
    goal = ctx.settings.position
    reached = is_look_inside_tolerance(ctx, last)
    moves = tuple(ctx.knowledge.moves)
    count = sum(1 for move in moves if move.kind == "move")
    reason = f"inside +-{goal.tolerance_mm:g} mm and {goal.tolerance_deg:g} deg after {count} moves"
    if not reached:
        reason = (
            f"not inside +-{goal.tolerance_mm:g} mm and {goal.tolerance_deg:g} deg after {count} moves (limit "
            f"{goal.moves_max}); {refuted_inputs(ctx) or 'calibrate and try again'}"
        )
    return PositionResult(
        reached=reached,
        reason=reason,
        tolerance_mm=goal.tolerance_mm,
        tolerance_deg=goal.tolerance_deg,
        start=error_of(first),
        end=error_of(last),
        moves=moves,
        calibration=calibration,
        t_start_plc_ns=first.record.t_plc_ns,
        duration_s=watch.total_s,
        seconds_by_step=tuple(watch.laps),
    )


class _StopWatch:
    """Seconds by step, on the given clock."""

    def __init__(self, clock_ns: Clock) -> None:
        self._clock_ns = clock_ns
        self._start_ns = self._last_ns = clock_ns()
        self.laps: list[tuple[str, float]] = []

    def record_lap_time(self, name: str) -> None:
        now_ns = self._clock_ns()
        self.laps.append((name, round((now_ns - self._last_ns) * 1e-9, 2)))
        self._last_ns = now_ns

    @property
    def total_s(self) -> float:
        return round((self._last_ns - self._start_ns) * 1e-9, 2)
