"""The paper's two methods and ours in the fast world: the server's own plans, deterministic, in the paper's pattern."""

import numpy as np
import pytest
from reproduce_worlds import NO_NOISE, NOISE, machine, world

from benchmarks.reproduce.cases import Case, line_case, matching_case, ours_case
from benchmarks.reproduce.error_budget import SOURCES, bootstrap_mean, changed
from benchmarks.reproduce.fast_cell import FastWorldError, context_of, fast_cell, run_plan
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.paper_setup import beside, nearer
from benchmarks.reproduce.summary import after_moves, held, inside, mean_errors, share
from benchmarks.reproduce.true_corners import TrueView
from benchmarks.reproduce.true_error import StepErrors
from machine.poses import inverse_pose
from server.jobs.requests import ReadMachine
from sim_plc.plant.plant import Plant


def tool_in_ooi(one) -> np.ndarray:
    T = Plant(one.plant, one.q_start_rad).T_base_tcp()
    return inverse_pose(one.scene.T_base_ooi) @ T @ one.scene.T_tcp_tool


def test_the_papers_set_up_is_its_distance_and_outside_of_the_circle():
    one = world("paper", 2)
    T = Plant(one.plant, one.q_start_rad).T_base_tcp()
    near = tool_in_ooi(nearer(one, T))
    before = tool_in_ooi(one)
    np.testing.assert_allclose(near[:2, 3], before[:2, 3], atol=1e-9)
    assert 0.30 < near[2, 3] < 0.62
    aside = tool_in_ooi(beside(one, T))
    assert np.linalg.norm(aside[:2, 3]) > 0.25
    seen = TrueView(beside(one, T)).corners(T)
    assert {marker.on for marker in seen if marker.left_px is not None} == {"tool", "ooi"}


def test_table_4s_pattern_first_y_then_millimetres():
    case = matching_case(machine(), 2, NOISE)
    assert case.state == "done", case.reason
    first, second = (step for step in case.steps if step.name.startswith("move"))
    assert 10.0 < abs(first.camera_image_mm[1]) < 60.0
    assert max(np.abs(second.camera_image_mm[:2])) < 9.0
    assert abs(second.camera_image_mm[2] - 100.0) < 25.0
    again = matching_case(machine(), 2, NOISE)
    assert again == case


@pytest.mark.parametrize("seed", [2, 4])
def test_the_improved_line_equation_beats_the_papers_in_camera_axes(seed):
    paper, fit = (line_case(machine(), seed, NOISE, variant) for variant in ("paper", "fit"))
    assert paper.state == fit.state == "done", (paper.reason, fit.reason)
    by_paper, by_fit = (np.abs(case.steps[-1].camera_true_mm[:2]) for case in (paper, fit))
    assert by_fit.max() < 8.0
    assert by_paper.max() > by_fit.max()


def test_the_servo_variant_adds_a_step_and_keeps_the_first():
    paper, servo = (line_case(machine(), 2, NOISE, variant) for variant in ("paper", "paper servo"))
    assert [step.name for step in servo.steps][:2] == ["oriented", "move"]
    assert servo.steps[1] == paper.steps[1]
    assert servo.steps[2].name == "servo 1"


def test_ours_in_a_machine_with_nothing_wrong_is_good_after_one_move():
    """It does not sag, but ours may expect the sag of its class: some millimetres, no more."""
    case = ours_case(machine(), "ideal", 1, NO_NOISE)
    assert case.state == "done", case.reason
    step = after_moves(case, 1)
    assert step is not None
    assert max(np.abs(step.goal_true_mm)) < 4.0
    assert inside(case, 1)


def test_a_source_of_error_can_be_taken_away_and_the_start_stays():
    one = world("realistic", 2)
    for change in SOURCES.values():
        np.testing.assert_allclose(tool_in_ooi(changed(one, change)), tool_in_ooi(one), atol=1e-9)
    mean, low, high = bootstrap_mean(np.random.default_rng(0).normal(3.0, 1.0, 100))
    assert low < mean < high
    assert abs(mean - 3.0) < 0.4


def test_requests_nobody_makes_are_refused_and_plans_run_to_their_result():
    one = world("realistic", 1)
    cell = fast_cell(one, QuasiStaticMachine(one), NO_NOISE)

    def plan():
        reading = yield ReadMachine()
        return reading

    np.testing.assert_allclose(run_plan(plan(), cell).q_rad, one.q_start_rad, atol=1.3e-5)
    assert context_of(one, "ours").machine is one.nominal
    with pytest.raises(FastWorldError):
        cell.perform("dance")  # type: ignore[arg-type]


def step(name: str, x_mm: float, sigma_mm: float = 1.0) -> StepErrors:
    three = (x_mm, 0.0, 0.0)
    return StepErrors(name, three, three, three, three, 0.1, 0.1, (sigma_mm, sigma_mm, sigma_mm))


def test_summaries_count_what_they_say():
    good = Case(1, "a", "done", "", (step("move 1", 4.0),))
    slow = Case(2, "a", "done", "", (step("move 1", -9.0), step("move 2", 1.0)))
    bad = Case(3, "a", "refused", "no view")
    cases = [good, slow, bad]
    assert [inside(case, 1) for case in cases] == [True, False, False]
    assert [inside(case, 2) for case in cases] == [True, True, False]
    mean = mean_errors(cases, "move 1")
    assert mean.n == 2
    assert mean.goal_true_mm[0] == pytest.approx(6.5)
    assert share([True] * 19 + [False]).low == pytest.approx(0.7513, abs=1e-3)
    assert share([]).n == 0
    assert held(cases).k == 4  # y and z of both, neither x
