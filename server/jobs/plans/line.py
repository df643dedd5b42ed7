"""The paper's line-equation method (section 3.2.1): orient, drive the circle while looking, one move, look."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machine.poses import pose
from machine.rotations import Array, nearest_rotation
from server.calibration.chords import positions_at
from server.calibration.contracts import CalibrationStatus, EncoderTrack
from server.calibration.line_equation import LineServo, LineServoSettings, circle_points, line_reference
from server.calibration.line_equation_fit import fit_line_moving
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.driving import drive_and_correct
from server.jobs.plans.looking import good_look
from server.jobs.plans.orienting import orient
from server.jobs.plans.planning import onto_reference, plan_settings, plan_to
from server.jobs.records import LineEquationLook, LineEquationResult
from server.jobs.requests import (
    Arm,
    MachineReading,
    Move,
    Progress,
    Request,
    SeenPairs,
    Settle,
    StartWatching,
    StopWatching,
    expect_reply,
)
from server.motion.contracts import PlanStatus
from server.motion.point_to_point import plan_through

LineVariant = Literal["paper", "paper servo", "fit", "fit, OOI axes"]


@dataclass(frozen=True, slots=True)
class WatchedCircle:
    """The circle as driven: where it began, the encoders' TCP, and every pair that showed both objects."""

    T_base_tcp_init: Array
    encoder_track: EncoderTrack
    seen_pairs: SeenPairs


def line_run(ctx: PlanContext, variant: LineVariant) -> Generator[Request, object, LineEquationResult]:
    """Orient, circle, one move to the reference of the variant, look; for the servo variant further steps.

    Raises: JobFailedError with the method's own reason when it gives no reference.
    """
    taken = yield from good_look(ctx)
    oriented = yield from orient(ctx, taken)
    watched = yield from drive_circle(ctx)
    T_ref, direction, note = _reference_and_direction(ctx, watched, variant)
    moved = yield from _move_and_look(ctx, T_ref, "line-equation move")
    looks = [("oriented", oriented), ("move", moved)]
    if variant == "paper servo":
        try:
            yield from _servo_along_line(ctx, direction, moved, looks)
        except JobFailedError as error:  # the first move stands; the servo's end is reported
            note = f"{note}; servo: {error}"
    return LineEquationResult(variant, note, tuple(_line_look(name, taken) for name, taken in looks))


def _line_look(name: str, taken: LookTaken) -> LineEquationLook:
    if taken.error is None:
        raise JobFailedError(f"look '{name}' failed: {taken.record.reason}", "look_rejected")
    return LineEquationLook(name, taken.error, taken.record.t_plc_ns)


def drive_circle(ctx: PlanContext) -> Generator[Request, object, WatchedCircle]:
    """The circle, point to point, resting at each (18 points); pairs are watched all the way."""
    reading = expect_reply((yield Settle()), MachineReading)
    T_init = ctx.tcp(reading.q_rad)
    stations = [pose(T_init[:3, :3], p) for p in circle_points(T_init)[1:]]
    plan = onto_reference(
        ctx, plan_through(ctx.machine, reading.q_rad, stations, plan_settings(ctx), ctx.wall), reading
    )
    if plan.status is not PlanStatus.OK or plan.trajectory is None:
        raise JobFailedError(f"circle: {plan.reason}", f"plan_{plan.status.value}")
    text = f"driving the circle in {plan.duration_s:.0f} s while looking"
    yield Progress("circle", 0.0, plan.duration_s, "s", text)
    yield Arm()
    yield StartWatching("mono")
    yield Move(plan.trajectory, "circle")
    yield Settle()
    sighted, encoder = expect_reply((yield StopWatching()), tuple)
    return WatchedCircle(T_init, encoder, sighted)


def _reference_and_direction(
    ctx: PlanContext, watched: WatchedCircle, variant: LineVariant
) -> tuple[Array, Array, str]:
    """T_base_tcp_ref, direction (3,) and a note of the variant."""
    if variant in ("paper", "paper servo"):
        return _by_minimum(watched)
    return _by_fit(ctx, watched, in_ooi_axes=variant == "fit, OOI axes")


def _by_minimum(watched: WatchedCircle) -> tuple[Array, Array, str]:
    """Eq. 13-16; each distance belongs to the TCP where the encoders stood when its pair was taken to be exposed."""
    track = watched.encoder_track
    points, _ = positions_at(watched.seen_pairs.t_s, track.t_s, track.Ts_base_tcp[:, :3, 3])
    distances = np.linalg.norm(watched.seen_pairs.vectors_cam[:, :2], axis=1)
    found = line_reference(watched.T_base_tcp_init, points, distances)
    if found.T_base_tcp_ref is None or found.direction_base is None:
        raise JobFailedError(f"line equation ({found.status.value}): {found.reason}", "line_refused")
    return found.T_base_tcp_ref, found.direction_base, f"residual {1e3 * found.residual_rms_m:.1f} mm rms"


def _by_fit(ctx: PlanContext, watched: WatchedCircle, in_ooi_axes: bool) -> tuple[Array, Array, str]:
    sighted = watched.seen_pairs
    vectors, R_tcp_view = sighted.vectors_cam, ctx.machine.T_tcp_cam_left[:3, :3]
    if in_ooi_axes:
        vectors = vectors @ nearest_rotation(np.median(sighted.Rs_cam_ooi, axis=0))
        R_tcp_view = ctx.machine.T_tcp_tool[:3, :3]  # after the orientation step the tool's axes are the OOI's
    goal = np.array([ctx.T_ooi_goal[0, 3], ctx.T_ooi_goal[1, 3]]) if in_ooi_axes else np.zeros(2)
    timed = fit_line_moving(
        watched.T_base_tcp_init, watched.encoder_track, sighted.t_s, vectors[:, :2] + goal, R_tcp_view
    )
    fit = timed.fit
    if fit.status is not CalibrationStatus.OK or fit.T_base_tcp_ref is None:
        raise JobFailedError(f"line fit ({fit.status.value}): {fit.reason}", "line_refused")
    way = fit.T_base_tcp_ref[:3, 3] - watched.T_base_tcp_init[:3, 3]
    offset = f"offset {1e3 * timed.time_offset_s:.0f} ms" if timed.offset_observable else "no offset seen"
    note = f"turned {np.rad2deg(fit.turn_rad):+.1f} deg, scale {fit.scale:.3f}, {offset}, {1e3 * fit.sigma_m:.1f} mm"
    return fit.T_base_tcp_ref, way / max(float(np.linalg.norm(way)), 1e-9), note


def _move_and_look(ctx: PlanContext, T_ref: Array, purpose: str) -> Generator[Request, object, LookTaken]:
    reading = expect_reply((yield Settle()), MachineReading)
    plan = plan_to(ctx, reading, T_ref)
    if plan.status is not PlanStatus.OK:
        raise JobFailedError(f"{purpose}: {plan.reason}", f"plan_{plan.status.value}")
    yield from drive_and_correct(ctx, plan, purpose)
    return (yield from good_look(ctx))


def _servo_along_line(
    ctx: PlanContext, direction: Array, moved: LookTaken, looks: list[tuple[str, LookTaken]]
) -> Generator[Request, object, None]:
    """Further steps of eq. 16 until the stepper ends them."""
    servo = LineServo(direction / np.linalg.norm(direction), LineServoSettings(steps_max=1))
    taken, number = moved, 0
    while True:
        look = taken.look
        if look.T_cam_tool is None or look.T_cam_ooi is None:
            return
        step = servo.next_reference(
            10.0 * number, ctx.tcp(taken.reading.q_rad), look.T_cam_tool[:3, 3], look.T_cam_ooi[:3, 3]
        )
        if step.T_base_tcp_ref is None:
            return
        number += 1
        taken = yield from _move_and_look(ctx, step.T_base_tcp_ref, f"servo step {number}")
        looks.append((f"servo {number}", taken))
