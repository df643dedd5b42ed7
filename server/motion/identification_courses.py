"""Motions that show what a machine does between command and encoder: each kind as offsets from one posture."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from machine.chain import Chain
from machine.description import Machine
from machine.kinematics import tcp_jacobian
from server.motion.contracts import Array, JointTrajectory, PlanStatus
from server.motion.refusal import Refusal
from server.motion.settings import PlanSettings
from server.motion.timing import limit_excess

Kind = Literal["repeat", "multisine", "steps", "sweep", "staircase", "workcycle", "hold"]
Shape = Callable[[np.random.Generator, float, int], Array]

KNOT_PERIOD_S = 0.1
REST_DURATION_S = 1.5  # at both ends of a course: what moves is over before the next begins
FADE_DURATION_S = 1.5
COURSE_REPEATS = 4
SPAN_RAD, SPAN_M = 0.18, 0.35  # most that a joint turns to either side, and most that the TCP goes by it
SAMPLE_PERIOD_S = 0.05
COURSE_SIZE_MIN_FRAC = 0.03  # of the intended size: less than that shows nothing any more
ITERATIONS_MAX = 20
LIMIT_MARGIN_FACTOR = 1.01  # beyond what a limit requires: the next round then passes
TCP_SPEED_FRAC = 0.55  # of the TCP's speed for each joint alone; the joints are not at their fastest at the same time


@dataclass(frozen=True, slots=True)
class SegmentMark:
    """A stretch of a trajectory that is a segment of the recording; `start_s`, `end_s` from the trajectory's start."""

    name: str
    kind: Kind
    start_s: float
    end_s: float
    repeat_of: str = ""


@dataclass(frozen=True, slots=True)
class MotionPart:
    """A part of the drive in which the joints move. `duration_s`: as long as it is in a drive of six minutes."""

    name: str
    kind: Kind
    duration_s: float
    course_generator: Shape
    effects_shown: tuple[str, ...]
    repeats: int = 1


@dataclass(frozen=True, slots=True)
class Course:
    """A reference by its knots (k, n) [rad] every `knot_s`: the cubic spline through them, at rest at both ends."""

    q: Array
    knot_s: float


def course_trajectory(course: Course, size_frac: float = 1.0) -> JointTrajectory:
    """The course around its first knot, `size_frac` as large; knots every 50 ms.

    Model:   q(t) = q_0 + size_frac (s(t) - q_0), s the clamped cubic spline. The PLC's quintic between knots with the
             spline's own rates is the spline itself wherever no knot of the spline lies between.
    """
    times = course.knot_s * np.arange(len(course.q))
    spline = CubicSpline(times, course.q, bc_type="clamped")
    count = max(2, int(np.ceil(times[-1] / SAMPLE_PERIOD_S - 1e-9)) + 1)
    t = np.linspace(0.0, times[-1], count)
    q, qd, qdd = (np.asarray(spline(t, order), dtype=float) for order in range(3))
    start = course.q[0]
    moved = JointTrajectory(t, start + size_frac * (q - start), size_frac * qd, size_frac * qdd)
    moved.q[0], moved.q[-1] = start, start + size_frac * (course.q[-1] - start)
    for rates in (moved.qd, moved.qdd):
        rates[0], rates[-1] = 0.0, 0.0
    return moved


def fitted_course(machine: Machine, chain: Chain, course: Course, settings: PlanSettings) -> JointTrajectory | Refusal:
    """The course at its own tempo, as small as the speeds and accelerations of joints and TCP require.

    Returns: its trajectory; or TOO_FAST where less than COURSE_SIZE_MIN_FRAC of it would be left.
    """
    size_frac, worst = 1.0, ""
    for _ in range(ITERATIONS_MAX):
        trajectory = course_trajectory(course, size_frac)
        found = limit_excess(machine, chain, trajectory, settings, settings.limit_share)
        if found.time_factor <= 1.0:
            return trajectory
        worst = found.limiting_quantity
        size_frac /= LIMIT_MARGIN_FACTOR * found.time_factor
        if size_frac < COURSE_SIZE_MIN_FRAC:
            break
    return Refusal(
        PlanStatus.TOO_FAST,
        f"{worst} leaves less than {100 * COURSE_SIZE_MIN_FRAC:.0f} % of the size; begin with the arm folded",
    )


def multisine_course(rng: np.random.Generator, seconds: float, n: int) -> Array:
    """Six sines of 0.07 to 0.8 Hz in every joint, the faster the smaller."""
    t = _knot_times(seconds)
    out = np.zeros((len(t), n))
    for j in range(n):
        f = np.exp(rng.uniform(np.log(0.07), np.log(0.8), 6))
        share = rng.uniform(0.3, 1.0, 6) / f**0.7
        out[:, j] = np.sin(2.0 * np.pi * f * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, 6)) @ share
    return out * _fade_window(t, seconds)


def slow_passes_course(rng: np.random.Generator, seconds: float, n: int) -> Array:
    """One slow sine in every joint, each with a period of its own: the speed passes zero both ways again and again."""
    t = _knot_times(seconds)
    period = seconds / rng.permutation(np.linspace(1.6, 3.6, n))
    return np.sin(2.0 * np.pi * t[:, None] / period) * rng.choice((-1.0, 1.0), n) * _fade_window(t, seconds)


def steps_course(rng: np.random.Generator, seconds: float, n: int) -> Array:
    """Quick moves of 0.8 s to other places and a rest at each, every joint by its own clock."""
    t = _knot_times(seconds)
    out = np.zeros((len(t), n))
    for j in range(n):
        at_s, here = float(rng.uniform(0.0, 1.0)), 0.0
        while at_s < seconds - 2.0:
            goal = 0.0 if at_s > seconds - 4.5 else float(rng.uniform(0.4, 1.0) * rng.choice((-1.0, 1.0)))
            out[:, j] += (goal - here) * _quintic_smoothstep((t - at_s) / 0.8)
            here, at_s = goal, at_s + float(rng.uniform(1.6, 2.8))
        out[:, j] -= here * _quintic_smoothstep((t - seconds + 1.6) / 0.8)
    return out


def staircase_course(rng: np.random.Generator, seconds: float, n: int) -> Array:
    """Small stairs up and down again with rests: what a command must be before anything moves."""
    t = _knot_times(seconds)
    stairs = max(2, int(seconds / 1.6 / 2.0))
    each_s = seconds / (2.0 * stairs)
    rise = sum(_quintic_smoothstep((t - (k + 0.2) * each_s) / 0.5) for k in range(stairs))
    fall = sum(_quintic_smoothstep((t - (stairs + k + 0.2) * each_s) / 0.5) for k in range(stairs))
    height = np.asarray(rise - fall, dtype=float) / stairs
    return height[:, None] * rng.uniform(0.15, 0.35, n) * rng.choice((-1.0, 1.0), n)


def work_cycle_course(rng: np.random.Generator, seconds: float, n: int) -> Array:
    """All joints together from place to place, and a rest at each."""
    t = _knot_times(seconds)
    count = max(2, round(seconds / 5.0))
    each_s = seconds / count
    out, here = np.zeros((len(t), n)), np.zeros(n)
    for k in range(count):
        goal = np.zeros(n) if k == count - 1 else rng.uniform(0.3, 1.0, n) * rng.choice((-1.0, 1.0), n)
        out += _quintic_smoothstep((t - k * each_s) / (0.7 * each_s))[:, None] * (goal - here)
        here = goal
    return out


def hold_still_course(rng: np.random.Generator, seconds: float, n: int) -> Array:
    """Standing still: what creeps under load, and the noise of encoders and camera."""
    del rng
    return np.zeros((len(_knot_times(seconds)), n))


PARTS: tuple[MotionPart, ...] = (
    MotionPart(
        "repeats", "repeat", 8.0, multisine_course, ("how much the machine repeats to: the noise",), COURSE_REPEATS
    ),
    MotionPart("slow passes", "sweep", 32.0, slow_passes_course, ("dead band", "hysteresis", "friction", "flow gain")),
    MotionPart("multisine", "multisine", 22.0, multisine_course, ("delay", "lag", "controller", "camera's clock")),
    MotionPart(
        "work cycle", "workcycle", 28.0, work_cycle_course, ("flow shared by joints", "load", "flow by direction")
    ),
    MotionPart("steps", "steps", 15.0, steps_course, ("lag", "limits of speed", "oscillation")),
    MotionPart("stairs", "staircase", 16.0, staircase_course, ("dead band", "breakaway", "resolution")),
    MotionPart("rest", "hold", 6.0, hold_still_course, ("creep under load",)),
)


def tcp_lever_arms(chain: Chain, q: Array) -> Array:
    """How far the TCP goes for each joint (n,) [m/rad], at least 0.1."""
    return np.maximum(np.linalg.norm(tcp_jacobian(chain, q)[:3], axis=0), 0.1)


def part_course(machine: Machine, chain: Chain, part: MotionPart, q_home: Array, settings: PlanSettings) -> Course:
    """A part's course about a posture, each joint as large as its range and its share of the speeds allow.

    Args:    q_home: the reference (n,) [rad] where it begins and ends.
    Returns: knots every 0.1 s: rest, motion, rest; a part that is repeated comes so many times.
    """
    rng = np.random.default_rng([len(part.name), sum(part.name.encode())])  # the same plan for the same machine
    unit = part.course_generator(rng, part.duration_s, chain.n)
    largest = np.abs(unit).max(axis=0)
    size = np.where(largest > 0.0, _allowed_amplitudes(machine, chain, unit, q_home, settings), 0.0)
    still = np.zeros((round(REST_DURATION_S / KNOT_PERIOD_S), chain.n))
    once = np.concatenate([still, unit * size, still])
    return Course(q_home + np.concatenate([once, *([once[1:]] * (part.repeats - 1))]), KNOT_PERIOD_S)


def part_marks(part: MotionPart) -> tuple[SegmentMark, ...]:
    """The segments of a part."""
    each_s = 2.0 * REST_DURATION_S + part.duration_s - KNOT_PERIOD_S
    if part.repeats == 1:
        return (SegmentMark(part.name, part.kind, 0.0, each_s),)
    return tuple(
        SegmentMark(f"{part.name} {k + 1}", part.kind, k * each_s, (k + 1) * each_s, part.name)
        for k in range(part.repeats)
    )


def _allowed_amplitudes(machine: Machine, chain: Chain, unit: Array, q_home: Array, settings: PlanSettings) -> Array:
    lever = tcp_lever_arms(chain, q_home)
    rate = np.abs(np.gradient(unit, KNOT_PERIOD_S, axis=0)).max(axis=0)
    bend = np.abs(np.gradient(np.gradient(unit, KNOT_PERIOD_S, axis=0), KNOT_PERIOD_S, axis=0)).max(axis=0)
    v_max = np.array([joint.qd_max_rad_s for joint in machine.joints]) * settings.limit_share
    a_max = np.array([joint.qdd_max_rad_s2 for joint in machine.joints]) * settings.limit_share
    v_max = np.minimum(v_max, TCP_SPEED_FRAC * machine.tcp_speed_max_m_s * settings.limit_share / lever)
    room = np.minimum(chain.q_max - q_home, q_home - chain.q_min) - settings.joint_margin_rad
    span = np.minimum(np.minimum(SPAN_RAD, SPAN_M / lever), np.maximum(room, 0.0))
    with np.errstate(divide="ignore"):
        return np.minimum.reduce([span / np.abs(unit).max(axis=0), v_max / rate, a_max / bend])


def _knot_times(seconds: float) -> Array:
    return KNOT_PERIOD_S * np.arange(round(seconds / KNOT_PERIOD_S), dtype=np.float64)


def _quintic_smoothstep(s: Array) -> Array:
    s = np.clip(s, 0.0, 1.0)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def _fade_window(t: Array, seconds: float) -> Array:
    return _quintic_smoothstep(np.minimum(t, seconds - KNOT_PERIOD_S - t) / FADE_DURATION_S)[:, None]
