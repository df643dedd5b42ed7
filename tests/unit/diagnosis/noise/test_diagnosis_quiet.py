"""A stage that leaves nothing on the undisturbed machine."""

from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import folder, recording

from diagnosis.baseline.left_over import cells_of, with_baseline
from diagnosis.noise.floor import Whitener
from diagnosis.reading.read import read_for_diagnosis
from diagnosis.replay.stage_floor import NOISELESS_SIGMA_MIN_FRAC
from diagnosis.replay.stage_replay import Replay
from machine.remainder import Remainder


def test_a_link_without_noise_is_as_quiet_as_its_repeats(tmp_path: Path) -> None:
    whole = read_for_diagnosis(folder(tmp_path, recording(("repeat", "repeat", "steps"), (), 3)))
    known = tuple(Remainder("link", joint, "", 0.0, 0.0) for joint in (1, 2, 3))
    link = next(cell for cell in cells_of(with_baseline(whole, (), known)) if cell.stage == "link")
    assert link.floor_known
    assert link.quiet < 0.01


@pytest.mark.parametrize(("sigma", "share"), [(0.0, NOISELESS_SIGMA_MIN_FRAC), (1e-9, 1.0)])
def test_a_controller_that_never_left_anything_is_held_to_a_quarter(tmp_path: Path, sigma: float, share: float) -> None:
    whole = read_for_diagnosis(folder(tmp_path, recording(("repeat", "repeat", "steps"), (), 3)))
    known = tuple(Remainder("controller", joint, "", sigma, sigma) for joint in (1, 2, 3))
    cells = cells_of(with_baseline(whole, (), known))
    (replay,) = (cell.whitened for cell in cells if cell.label == "controller 2")
    assert isinstance(replay, Replay)
    plain = next(cell.whitened for cell in cells_of(with_baseline(whole, (), ())) if cell.label == "controller 2")
    assert isinstance(plain, Replay)
    assert replay.whitener.innovation_sigma == pytest.approx(share * plain.whitener.innovation_sigma)


def test_lags_that_nothing_uses_cost_no_part_of_a_stretch() -> None:
    a = np.array([[0.4, 0.0], [0.0, 0.0], [0.2, 0.0]])
    whitener = Whitener(a, np.array([1.0, 2.0]))
    assert whitener.of_channels([0]).lag_count == 3
    assert whitener.of_channels([1]).lag_count == 0
    assert whitener.of_channels([1]).innovation_sigma == pytest.approx([2.0])
