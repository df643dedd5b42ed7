"""The judge's own filters against scipy's."""

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.diagnosis.sealed.filters import filtered_by, response_of, whitened_by
from benchmarks.diagnosis.sealed.whitening import beside

X = np.random.default_rng(3).normal(size=300)
AR = np.array([0.9, -0.3, 0.05])


def test_filters_are_scipys() -> None:
    b, a = np.array([0.2, 0.1, -0.05]), np.array([1.0, -0.7, 0.2])
    assert filtered_by(b, a, X) == pytest.approx(lfilter(b, a, X), abs=1e-12)
    assert whitened_by(AR, X) == pytest.approx(lfilter([1.0, *-AR], [1.0], X), abs=1e-12)
    assert whitened_by(AR, response_of(AR, 50)) == pytest.approx(np.eye(1, 50)[0], abs=1e-12)


def test_what_a_number_varies_by_counts_beside_the_noise_and_nothing_else_does() -> None:
    column = 3.0 * np.eye(1, 300)[0]  # a standard deviation of the number moves one row by three floors
    assert beside(X, []) is X
    seen = beside(X, [column])
    assert seen[0] == pytest.approx(X[0] / np.sqrt(10.0))
    assert seen[1:] == pytest.approx(X[1:])
