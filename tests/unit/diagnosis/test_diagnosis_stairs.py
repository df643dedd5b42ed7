"""A coarse encoder's stairs, for points behind the joint."""

import numpy as np

from diagnosis.stairs import coarse_joints, unstepped


def test_a_coarse_encoders_stairs_are_a_ramp_and_a_fine_ones_stay() -> None:
    t = 0.01 * np.arange(4000)
    q = np.stack([0.5 * np.sin(0.3 * t), 0.5 * np.sin(0.3 * t)], axis=1)
    step = np.array([8e-4, 2e-5])
    enc = np.round(q / step) * step
    assert coarse_joints(enc) == (1,)
    out = unstepped(enc, (1,), 0.01)
    assert np.array_equal(out[:, 1], enc[:, 1])
    before, after = (float(np.median(np.abs(of[:, 0] - q[:, 0]))) for of in (enc, out))
    assert after < 0.5 * before, after / before
