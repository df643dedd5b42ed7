"""Figures of the many-machines bench on runs made by hand: what counts, what fails, what is honest."""

import numpy as np
import pytest

from benchmarks.positioning.machines.figures import accuracy, disobedient, honesty, refusals, seconds, worst
from benchmarks.positioning.machines.machine_run import MachineRun, MoveErrors
from benchmarks.positioning.machines.paired import paired_change

C = [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]]


def move(x=0.0, y=0.0, z=0.0, deg=0.1):
    return MoveErrors((x, y, z), (x, y, z), deg, (2.0, 2.0, 2.0), C, 600.0, 1, None)


def run(seed, *moves, state="done", reason="", look_m=0.5, path_m=0.5, rest_s=50.0, again_s=20.0):
    return MachineRun(
        seed,
        "realistic",
        "default",
        state,
        reason,
        list(moves),
        last_look_goal_m=look_m,
        path_goal_m=path_m,
        rest_s=rest_s,
        again_rest_s=again_s,
    )


def test_a_refused_job_is_a_failure_though_its_first_move_was_inside():
    runs = [run(1, move(1.0)), run(2, move(1.0), state="refused", reason="look failed: 3 of 20")]
    assert accuracy(runs, 1).inside.k == 1
    assert accuracy(runs, 1).inside.n == 2
    assert refusals(runs) == [("look failed: # of ##", [2])]


def test_a_job_that_needed_fewer_moves_stays_where_it_is():
    runs = [run(1, move(8.0), move(1.0)), run(2, move(2.0)), run(3, move(0.0, 6.0), move(0.0, 7.0))]
    assert [accuracy(runs, moves).inside.k for moves in (1, 2, 3)] == [1, 2, 2]
    assert [seed for seed, _ in worst(runs, 1, 2)] == [1, 3]


def test_depth_does_not_decide_success():
    assert run(1, move(0.0, 0.0, 30.0)).inside(1)


def test_a_machine_without_a_scene_is_not_counted():
    undrawn = MachineRun(7, "realistic", "default", "undrawn", "no usable scene")
    assert accuracy([undrawn, run(1, move())], 1).inside.n == 1


@pytest.mark.parametrize(("look_m", "path_m"), [(0.29, 0.5), (0.5, 0.24)])
def test_who_looks_or_drives_too_near_is_named(look_m, path_m):
    assert disobedient([run(1, move()), run(2, move(), look_m=look_m, path_m=path_m)]) == [2]


def test_predictions_that_are_honest_hold_95_per_cent_and_others_do_not():
    rng = np.random.default_rng(1)
    for factor, low, high in ((1.0, 0.93, 0.97), (0.5, 0.99, 1.0), (2.0, 0.5, 0.8)):
        runs = [run(seed, move(*(2.0 * factor * rng.standard_normal(3)))) for seed in range(1500)]
        found = honesty(runs)
        assert low <= found.pooled.value <= high
        assert found.nees == pytest.approx(factor**2, rel=0.1)
        assert found.ratio == pytest.approx([factor] * 3, rel=0.1)


def test_seconds_leave_out_refused_and_missing_ones():
    runs = [run(1, move(), rest_s=10.0), run(2, move(), rest_s=30.0, again_s=float("nan")), run(3, state="refused")]
    (middle, _), (again, _) = seconds(runs)
    assert middle == 20.0
    assert again == 20.0


def test_newcombes_own_example():
    """Newcombe 1998, table II, method 10: a 36, b 12, c 2, d 0 of 50: 0.20 with 0.0569 to 0.3404."""
    first = [True] * 36 + [True] * 12 + [False] * 2
    second = [True] * 36 + [False] * 12 + [True] * 2
    found = paired_change(second, first)
    assert found.value == pytest.approx(0.20)
    assert (found.low, found.high) == pytest.approx((0.0569, 0.3404), abs=2e-3)
    assert (found.only_default, found.only_other) == (2, 12)


def test_equal_outcomes_change_nothing_and_unequal_lengths_are_refused():
    found = paired_change([True] * 30, [True] * 30)
    assert found.low < found.value == 0.0 < found.high
    with pytest.raises(ValueError, match="2 and 3"):
        paired_change([True] * 3, [True] * 2)
