"""A course as a trajectory: its spline to the bit between knots, and inside every limit."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from machine.chain import chain_of
from server.motion.contracts import JointTrajectory, PlanStatus, evaluate_trajectory
from server.motion.identification_courses import Course, course_trajectory, fitted_course
from server.motion.refusal import Refusal
from server.motion.settings import PAPER_PLAN_SETTINGS
from server.motion.timing import limit_excess
from server.settings import read_machine

MACHINE = read_machine("hiab033")
CHAIN = chain_of(MACHINE)
START = np.deg2rad([10.0, 42.0, -85.0, 4.0, -43.0, 3.0])


def waves(size_rad, joint=0, seconds=20.0):
    """One joint there and back around START, from rest to rest, knots every 0.1 s."""
    t = np.arange(0.0, seconds + 0.05, 0.1)
    u = np.clip(np.minimum(t, t[-1] - t) / 3.0, 0.0, 1.0)
    q = np.tile(START, (len(t), 1))
    q[:, joint] += size_rad * (10 * u**3 - 15 * u**4 + 6 * u**5) * np.sin(1.1 * t)
    return Course(q, 0.1)


def test_the_plc_plays_the_spline_that_was_foretold():
    course = waves(0.1)
    made = course_trajectory(course)
    t = np.linspace(0.3, 19.7, 1777)
    wanted = CubicSpline(0.1 * np.arange(len(course.q)), course.q, bc_type="clamped")(t)
    assert np.abs(evaluate_trajectory(made, t).q - wanted).max() < 1e-12
    assert np.abs(made.qd[[0, -1]]).max() == 0.0
    assert np.abs(made.qdd[[0, -1]]).max() == 0.0
    assert np.array_equal(made.q[0], START)


def test_too_fast_a_course_is_made_smaller():
    course = waves(0.3)  # slewing so at 3 m: far beyond the TCP's 0.15 m/s
    plain = limit_excess(MACHINE, CHAIN, course_trajectory(course), PAPER_PLAN_SETTINGS, 0.9)
    assert plain.time_factor > 2.0
    found = fitted_course(MACHINE, CHAIN, course, PAPER_PLAN_SETTINGS)
    assert isinstance(found, JointTrajectory)
    assert limit_excess(MACHINE, CHAIN, found, PAPER_PLAN_SETTINGS, 0.9).time_factor <= 1.0
    assert np.ptp(found.q[:, 0]) < 0.5 * np.ptp(course.q[:, 0])
    assert found.duration_s == pytest.approx(20.0)


def test_what_fits_is_left_as_it_is():
    course = waves(0.02, joint=5)
    found = fitted_course(MACHINE, CHAIN, course, PAPER_PLAN_SETTINGS)
    assert isinstance(found, JointTrajectory)
    assert np.array_equal(found.q, course_trajectory(course).q)


def test_what_would_be_nothing_is_refused():
    found = fitted_course(MACHINE, CHAIN, waves(60.0), PAPER_PLAN_SETTINGS)
    assert isinstance(found, Refusal)
    assert found.status is PlanStatus.TOO_FAST
    assert "begin with the arm folded" in found.reason
