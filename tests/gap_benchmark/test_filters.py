"""The judge's own filters against scipy's."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.gap_benchmark.filters import filtered_by, response_of, whitened_by

X = np.random.default_rng(3).normal(size=300)
AR = np.array([0.9, -0.3, 0.05])


def test_filters_are_scipys() -> None:
    b, a = np.array([0.2, 0.1, -0.05]), np.array([1.0, -0.7, 0.2])
    assert filtered_by(b, a, X) == pytest.approx(lfilter(b, a, X), abs=1e-12)
    assert whitened_by(AR, X) == pytest.approx(lfilter([1.0, *-AR], [1.0], X), abs=1e-12)
    assert whitened_by(AR, response_of(AR, 50)) == pytest.approx(np.eye(1, 50)[0], abs=1e-12)
