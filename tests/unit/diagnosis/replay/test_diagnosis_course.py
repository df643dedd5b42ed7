"""The command between two logged rows: a curve where it is smooth, a jump where it jumps."""

from dataclasses import replace

import numpy as np
from diagnosis_cases import PLANT

from diagnosis.replay.course import jump_rows, late_jump_course, smooth_course
from machine.effects.dynamics import at_cycles

TENTH = replace(PLANT, log_cycle_s=10 * PLANT.cycle_s)


def rows_of(course: np.ndarray) -> np.ndarray:
    return np.repeat(course[::10, None], PLANT.n, axis=1)


def test_a_sine_is_met_ten_times_as_well_as_by_lines() -> None:
    t = PLANT.cycle_s * np.arange(4001)
    course = 0.4 * np.sin(2.0 * np.pi * 1.5 * t)
    rows = rows_of(course)
    off, lines = (
        np.abs(one[:, 0] - course)[20:-20].max() for one in (smooth_course(TENTH, rows), at_cycles(TENTH, rows))
    )
    assert off < 0.1 * lines


def test_a_jump_is_a_line_and_nothing_swings_beside_it() -> None:
    course = np.where(np.arange(401) < 205, 0.1, 0.7)
    rows = rows_of(course)
    found = smooth_course(TENTH, rows)[:, 0]
    assert jump_rows(rows)[:, 0].nonzero()[0].tolist() == [20]
    assert np.allclose(found, at_cycles(TENTH, rows)[:, 0])
    held = late_jump_course(TENTH, rows)[:, 0]
    assert np.allclose(held, np.where(np.arange(401) < 210, 0.1, 0.7))


def test_of_a_slow_ramp_nothing_is_a_jump() -> None:
    rows = rows_of(np.linspace(0.0, 1.0, 401))
    assert not jump_rows(rows)[1:-2].any()
    assert np.allclose(smooth_course(TENTH, rows), at_cycles(TENTH, rows))
