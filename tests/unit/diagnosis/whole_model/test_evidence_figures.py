"""Scatter of a size between groups, and the trained model from the figures to a probability."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from diagnosis.whole_model.evidence import groupings_of, scatter_between_groups
from diagnosis.whole_model.probability import (
    EVIDENCE_FEATURE_NAMES,
    fit_logistic,
    logistic,
    probability_of,
    trained_calibration,
)
from machine.rotations import Array

GROUPS, ROWS, COLUMNS = 5, 400, 3


def scatter_of(rng: np.random.Generator, sizes: Array, short: float = 0.0) -> float:
    """Scatter of the first column, whose true size in each group is given; the others are the same everywhere.

    `short`: by how much the fit stopped short of its optimum.
    """
    group = np.arange(ROWS) * GROUPS // ROWS
    J = rng.normal(size=(ROWS, COLUMNS)) + 0.5 * rng.normal(size=(ROWS, 1))
    y = J[:, 0] * sizes[group] + J[:, 1:] @ np.array([2.0, -1.0]) + rng.normal(size=ROWS)
    best = np.linalg.lstsq(J, y, rcond=None)[0]
    return scatter_between_groups(J, J @ (best + short) - y, np.array([0]), [group])


def test_a_size_that_is_the_same_in_every_group_seldom_scatters() -> None:
    rng = np.random.default_rng(7)
    found = [scatter_of(rng, np.full(GROUPS, 3.0)) for _ in range(400)]
    assert np.mean([one == 0.0 for one in found]) > 0.8
    assert max(found) < 0.3


def test_a_fit_that_stopped_short_of_its_optimum_is_no_difference_between_groups() -> None:
    exact, short = (scatter_of(np.random.default_rng(9), np.full(GROUPS, 3.0), short) for short in (0.0, 0.5))
    assert short == pytest.approx(exact)


def test_the_scatter_is_that_of_the_sizes() -> None:
    rng = np.random.default_rng(7)
    sizes = np.array([3.0, 2.2, 3.6, 2.8, 4.0])
    found = [scatter_of(rng, sizes) for _ in range(50)]
    assert np.median(found) == pytest.approx(sizes.std(ddof=1), rel=0.25)


def test_a_size_that_goes_with_the_position_or_the_time_of_one_part_is_found_out() -> None:
    """Kinds of motion agree: every one holds all positions and lasts as long; a cable or warm oil is seen only so."""
    rng = np.random.default_rng(5)
    kind, position = np.arange(ROWS) % GROUPS, rng.uniform(-1.0, 1.0, ROWS)
    parts = tuple(
        SimpleNamespace(rows=SimpleNamespace(row_count=count), t_s=np.arange(count) * 0.1, regressors=regressors)
        for count, regressors in ((100, ()), (ROWS - 100, (("position", position[100:]),)))
    )
    cell = cast(Any, SimpleNamespace(rows=SimpleNamespace(fold=kind, row_count=ROWS), joined_cells=parts))
    late = (np.arange(ROWS) - 100.0) / (ROWS - 100.0)
    found = {}
    for name, size in (
        ("the same", np.full(ROWS, 3.0)),
        ("by position", 3.0 + np.where(position > 0.0, 0.6, -0.6)),
        ("by time", 3.0 + np.where(late > 0.0, late, 0.0)),
    ):
        J = rng.normal(size=(ROWS, COLUMNS))
        y = J[:, 0] * size + rng.normal(size=ROWS)
        residual = J @ np.linalg.lstsq(J, y, rcond=None)[0] - y
        found[name] = [
            scatter_between_groups(J, residual, np.array([0]), groups) for groups in ([kind], groupings_of(cell))
        ]
    assert max(found["the same"]) < 0.15
    assert found["by position"][0] < 0.2 < 0.4 < found["by position"][1] < 0.8
    assert found["by time"][0] < 0.2 < found["by time"][1] < 0.8


def test_one_group_alone_says_nothing() -> None:
    J = np.ones((4, 1))
    assert scatter_between_groups(J, np.ones(4), np.array([0]), [np.zeros(4, dtype=np.int64)]) == 0.0


def test_fitted_reproduces_the_logistic_that_drew_the_labels() -> None:
    rng = np.random.default_rng(3)
    X = rng.normal(size=(8000, 3)) * np.array([1.0, 2.0, 0.5]) + np.array([0.0, 4.0, -1.0])
    intercept, weights = -3.0, np.array([1.5, 0.6, 0.0])
    right = (rng.uniform(size=len(X)) < logistic(intercept + X @ weights)).astype(float)
    found, w = fit_logistic(X, right)
    assert np.abs(logistic(found + X @ w) - logistic(intercept + X @ weights)).mean() < 0.015
    assert w == pytest.approx(weights, abs=0.15)


def test_fitted_is_monotone_where_the_labels_are_not() -> None:
    rng = np.random.default_rng(4)
    X = rng.normal(size=(500, 2))
    right = (X[:, 0] < 0.0).astype(float)  # the larger, the less right: against what a figure means
    _, w = fit_logistic(X, right)
    assert w[0] == 0.0
    assert (w >= 0.0).all()


def test_separable_labels_and_figures_that_never_vary_give_finite_numbers() -> None:
    X = np.stack([np.linspace(-1.0, 1.0, 40), np.ones(40)], axis=1)
    right = (X[:, 0] > 0.0).astype(float)
    intercept, w = fit_logistic(X, right)
    assert np.isfinite([intercept, *w]).all()
    assert w[1] == 0.0
    assert (logistic(intercept + X @ w)[right > 0.5] > 0.5).all()


def test_the_shipped_calibration_is_monotone_and_says_what_it_was_fitted_on() -> None:
    table = trained_calibration()
    assert set(table["weights"]) == set(EVIDENCE_FEATURE_NAMES)
    assert min(table["weights"].values()) >= 0.0
    assert table["cases"] >= 20
    assert table["reliability"]
    assert probability_of(np.zeros(len(EVIDENCE_FEATURE_NAMES))) < 0.5
