"""Samples that a logger dropped, with the last one written again, are told; slow joints and fast logs are not."""

import numpy as np
import pytest

from diagnosis.log.frozen import frozen_findings, frozen_runs


def moving(noise_rad: float = 0.0, step_rad: float = 0.0) -> np.ndarray:
    t = 0.01 * np.arange(3000)
    q = np.stack([0.3 * np.sin(0.7 * t), 0.1 * np.sin(1.9 * t)], axis=1)
    q += np.random.default_rng(1).normal(0.0, noise_rad, q.shape)
    return np.round(q / step_rad) * step_rad if step_rad else q


@pytest.mark.parametrize(("noise_rad", "step_rad"), [(1e-5, 0.0), (0.0, 2.4e-5)])
def test_each_run_is_found(noise_rad: float, step_rad: float) -> None:
    enc = moving(noise_rad, step_rad)
    for start in range(100, 2900, 150):
        enc[start : start + 5] = enc[start - 1]
    found = frozen_findings(enc)
    assert [one.code for one in found] == ["frozen"]
    assert found[0].count >= 15  # a few lie where the joints turn round
    assert "look at the logger" in found[0].text


@pytest.mark.parametrize("step_rad", [0.0, 2.4e-5, 4e-4, 3e-3])
def test_a_coarse_encoder_is_no_fault(step_rad: float) -> None:
    assert frozen_findings(moving(0.0, step_rad)) == []


def test_a_log_faster_than_its_plc_is_no_fault() -> None:
    assert frozen_runs(np.repeat(moving(), 5, axis=0)) == []


def test_a_joint_at_rest_is_no_fault() -> None:
    enc = moving(0.0, 2.4e-5)
    enc[1000:2000] = enc[1000]
    assert frozen_findings(enc) == []
