"""A proposed experiment as a trajectory of the reference: its spline, made small or slow enough for every limit."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from machine.chain import Chain
from machine.description import Machine
from server.motion.contracts import Array, JointTrajectory, PlanStatus
from server.motion.refusal import Refusal
from server.motion.settings import PlanSettings
from server.motion.timing import excess

Keep = Literal["tempo", "size"]

SAMPLE_S = 0.05
SIZE_MIN_FRAC = 0.03  # of the proposed size: less than that separates nothing any more
SLOWER_MAX = 12.0  # times the proposed duration
DURATION_MAX_S = 1200.0
ROUNDS = 20
SPARE = 1.01  # beyond what a limit asks for: the next round then passes


@dataclass(frozen=True, slots=True)
class Course:
    """A reference by its knots (k, n) [rad] every `knot_s`: the cubic spline through them, at rest at both ends."""

    q: Array
    knot_s: float


@dataclass(frozen=True, slots=True)
class Fitted:
    """A course as it may be driven: `size_frac` of the proposed size, `slower` times the proposed duration."""

    trajectory: JointTrajectory
    size_frac: float
    slower: float


def course_trajectory(course: Course, size_frac: float = 1.0, slower: float = 1.0) -> JointTrajectory:
    """The course around its first knot, `size_frac` as large and `slower` times as long; knots every 50 ms or more.

    Model:   q(t) = q_0 + size (s(t / slower) - q_0), s the clamped cubic spline. The PLC's quintic between knots with
             the spline's own rates is the spline itself wherever no knot of the spline lies between.
    """
    times = course.knot_s * np.arange(len(course.q))
    spline = CubicSpline(times, course.q, bc_type="clamped")
    step_s = SAMPLE_S * max(1.0, np.floor(min(slower, 4.0)))  # the PLC takes knots up to 0.2 s apart
    count = max(2, int(np.ceil(times[-1] * slower / step_s - 1e-9)) + 1)
    t = np.linspace(0.0, times[-1] * slower, count)
    q, qd, qdd = (np.asarray(spline(t / slower, order), dtype=float) / slower**order for order in range(3))
    start = course.q[0]
    moved = JointTrajectory(t, start + size_frac * (q - start), size_frac * qd, size_frac * qdd)
    moved.q[0], moved.q[-1] = start, start + size_frac * (course.q[-1] - start)
    for rates in (moved.qd, moved.qdd):
        rates[0], rates[-1] = 0.0, 0.0
    return moved


def fitted_course(
    machine: Machine, chain: Chain, course: Course, settings: PlanSettings, keep: Keep
) -> Fitted | Refusal:
    """The course within the speeds and accelerations of joints and TCP.

    Args:    keep: "tempo" makes it smaller where it is too fast, "size" makes it longer.
    Returns: the fitted course; or TOO_FAST where nothing useful would be left of it.
    """
    tried = Fitted(course_trajectory(course), 1.0, 1.0)
    worst = ""
    for _ in range(ROUNDS):
        found = excess(machine, chain, tried.trajectory, settings, settings.limit_share)
        if found.factor <= 1.0:
            return tried
        worst = found.worst
        size, slower = tried.size_frac, tried.slower
        if keep == "tempo":
            size /= SPARE * found.factor
        else:
            slower *= SPARE * found.factor
        if size < SIZE_MIN_FRAC or slower > SLOWER_MAX or slower * course.knot_s * len(course.q) > DURATION_MAX_S:
            break
        tried = replace(tried, trajectory=course_trajectory(course, size, slower), size_frac=size, slower=slower)
    other = "keep its size and drive it slower" if keep == "tempo" else "keep its tempo and drive it smaller"
    return Refusal(
        PlanStatus.TOO_FAST,
        f"{worst} leaves less than {100 * SIZE_MIN_FRAC:.0f} % of the size, or takes more than {SLOWER_MAX:.0f} times "
        f"the time; {other}, or begin with the arm folded",
    )
