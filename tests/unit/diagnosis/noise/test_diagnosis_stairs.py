"""A coarse encoder's stairs, for points behind the joint."""

from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import likely
from foreign_plant import Fault, write

from diagnosis.answer import answer_json
from diagnosis.behind.stairs import smooth_encoder_steps, steps_visible_at_tip
from diagnosis.budget import budget_of
from diagnosis.noise.floor import encoder_step
from diagnosis.reading.read import read_for_diagnosis


def test_a_coarse_encoders_stairs_are_a_ramp_and_a_fine_ones_stay() -> None:
    t = 0.01 * np.arange(4000)
    q = np.stack([0.5 * np.sin(0.3 * t), 0.5 * np.sin(0.3 * t)], axis=1)
    step = np.array([8e-4, 2e-5])
    enc = np.round(q / step) * step
    steps = steps_visible_at_tip(np.array([encoder_step(raw) for raw in enc.T]))
    assert steps == pytest.approx([8e-4, 0.0])
    out = smooth_encoder_steps(enc, steps, 0.01)
    assert np.array_equal(out[:, 1], enc[:, 1])
    before, after = (float(np.median(np.abs(of[:, 0] - q[:, 0]))) for of in (enc, out))
    assert after < 0.5 * before, after / before


@pytest.mark.parametrize("deadband", [0.0, 0.08])
def test_a_machine_with_twelve_bits_in_its_loop_is_judged_by_its_faults(tmp_path: Path, deadband: float) -> None:
    """Encoders that step back and forth were its reversals, and what a tracker saw of their steps a gap."""
    fault = Fault(deadband=(deadband, 0.0))
    place = write(tmp_path / "run", fault, seconds=20.0, tracker_m=2e-4, log_s=0.02, counts=4096)
    found = answer_json(budget_of(read_for_diagnosis(place)))
    assert found["verdict"] == ("effects" if deadband else "none"), found["why"]
    named = [(one["name"], one["joint"]) for one in likely(found)]
    assert named == ([("valve_deadband", 1)] if deadband else [])
