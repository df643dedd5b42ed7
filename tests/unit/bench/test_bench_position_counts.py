"""How a run of `longreach bench position` is counted: where the machine stood, and where the job ended."""

import numpy as np

from benchmarks.positioning.end_to_end import TRUTH_COLUMNS, Case, StepErrors, inside, inside_after, join_truth


def step(name: str, x_mm: float) -> StepErrors:
    return StepErrors(name, (x_mm, 0.0, 0.0), 0.1, (x_mm, 0.0, 0.0), 0.1, (x_mm, 0.0, 100.0))


def case(*steps: StepErrors, reached: bool = True) -> Case:
    moves = sum(one.name.startswith("move") for one in steps)
    return Case("realistic", "ours", 1, "done", "", reached, moves, 60.0, [], None, list(steps))


def test_the_truth_of_a_look_is_that_of_the_rest_before_it() -> None:
    t_ns = 5_000_000_000 + np.arange(-1000, 1000, 20) * 1_000_000
    away_mm = np.where(
        t_ns > 5_000_000_000, 30.0, np.where(t_ns < 4_680_000_000, -20.0, 1.0)
    )  # the next motion, the last
    truth = {"t_plc_ns": t_ns, **dict.fromkeys(TRUTH_COLUMNS, away_mm)}
    image = dict.fromkeys(("x_mm", "y_mm", "z_mm", "rotation_deg", "camera_x_mm", "camera_y_mm", "camera_z_mm"), 1.0)
    (start,) = join_truth({"start": image, "t_start_plc_ns": 5_000_000_000, "moves": []}, truth)
    assert (start.true_mm, start.true_deg) == ((1.0, 1.0, 1.0), 1.0)


def test_a_machine_that_stood_inside_counts_though_its_job_went_on() -> None:
    went_on = case(step("start", 40.0), step("move 1", 4.8), step("move 2", 0.5))
    assert inside_after(went_on, 1)
    assert not inside(went_on, 1)
    assert inside(went_on, 2)


def test_outside_after_the_first_move_is_outside() -> None:
    corrected = case(step("start", 40.0), step("move 1", 5.1), step("move 2", 0.5))
    assert not inside_after(corrected, 1)
    assert inside_after(corrected, 2)
    assert inside_after(corrected, 3)


def test_a_job_without_a_move_is_a_failure() -> None:
    assert not inside_after(case(step("start", 2.0), reached=False), 1)
    assert not inside_after(case(reached=False), 3)
