"""A simulator of finer steps than ours is no gap: the nominal model is defined for any step up to 1 ms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import PLANT, folder, recording

from diagnosis.baseline.left_over import cells_of
from diagnosis.cells.own_step import StepShare, agreed_share
from diagnosis.reading.read import read_for_diagnosis
from diagnosis.search.fit import neutral_fit

KINDS = ("repeat", "repeat", "repeat", "repeat", "steps")
QUIET_RAD = 2e-6  # an encoder far better than most, which shows the steps


@pytest.mark.parametrize("refined", [1, 4, 10])
def test_finer_steps_leave_no_more_than_noise(tmp_path: Path, refined: int) -> None:
    made = recording(KINDS, seed=5, plant=replace(PLANT, step_refinement_factor=refined), noise_rad=QUIET_RAD)
    cells = [
        one for one in cells_of(read_for_diagnosis(folder(tmp_path, made))) if one.stage == "actuator" and one.joint
    ]
    left = [float(np.mean(neutral_fit(one).residual ** 2)) for one in cells]
    assert len(left) == 6
    assert max(left) < 1.4


def test_a_step_is_told_by_joints_on_which_nothing_else_is_wrong() -> None:
    sure, vague, faulty = StepShare(0.6, 0.01, 1.0), StepShare(0.2, 5.0, 1.0), StepShare(40.0, 0.01, 200.0)
    assert agreed_share([sure, vague, faulty]) == pytest.approx(0.6, abs=1e-3)
    assert agreed_share([faulty]) == agreed_share([]) == 0.0
    assert agreed_share([StepShare(0.01, 0.01, 1.0)]) == agreed_share([vague]) == 0.0
    assert 0.5 < agreed_share([StepShare(0.7, 0.16, 1.0)]) < 0.7
