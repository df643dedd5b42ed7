"""The best set of effects, against all sets of small random problems."""

from itertools import product

import numpy as np
import pytest

from diagnosis.whole_model.subsets import LinearProblem, best_set

TERMS = 8
SEEDS = range(12)


def problem_of(seed: int) -> LinearProblem:
    """Eight terms of one or two columns, correlated; three of them are there."""
    rng = np.random.default_rng(seed)
    widths = rng.choice((1, 1, 2), TERMS)
    first = np.concatenate([[0], np.cumsum(widths)]).astype(np.int64)
    J = rng.normal(size=(60, first[-1])) + 0.7 * rng.normal(size=(60, 1))
    there = np.repeat(np.isin(np.arange(TERMS), rng.choice(TERMS, 3, replace=False)), widths)
    y = J @ np.where(there, rng.normal(0.0, 1.0, len(there)), 0.0) + rng.normal(size=60)
    return LinearProblem(
        J.T @ J, J.T @ y, np.full(first[-1], 2.0), first, np.zeros(first[-1], dtype=bool), np.full(TERMS, -1.5)
    )


def every_set(problem: LinearProblem) -> tuple[np.ndarray, np.ndarray]:
    """All sets with their log posterior from the marginal likelihood of y, written out."""
    sets = np.array(list(product((False, True), repeat=problem.term_count)))
    scores = []
    for members in sets:
        cols = np.repeat(members, np.diff(problem.term_first_column))
        H, c, slab = problem.normal_matrix[np.ix_(cols, cols)], problem.normal_rhs[cols], problem.prior_sigma[cols]
        precision = H + np.diag(slab**-2.0)
        evidence = 0.5 * c @ np.linalg.solve(precision, c) if cols.any() else 0.0
        volume = np.linalg.slogdet(precision)[1] + 2.0 * np.log(slab).sum() if cols.any() else 0.0
        scores.append(problem.log_odds[members].sum() + evidence - 0.5 * volume)
    return sets, np.array(scores)


@pytest.mark.parametrize("seed", SEEDS)
def test_best_set_is_that_of_all_sets(seed: int) -> None:
    problem = problem_of(seed)
    sets, scores = every_set(problem)
    allowed = np.ones(TERMS, dtype=bool)
    found = best_set(problem, allowed, allowed)
    assert found.tolist() == sets[np.argmax(scores)].tolist()


def test_a_set_holds_only_what_is_allowed() -> None:
    problem = problem_of(0)
    allowed = np.arange(TERMS) != int(np.nonzero(best_set(problem, np.ones(TERMS, bool), np.ones(TERMS, bool)))[0][0])
    sets, scores = every_set(problem)
    inside = ~(sets & ~allowed).any(axis=1)
    best = sets[inside][np.argmax(scores[inside])]
    assert best_set(problem, np.ones(TERMS, dtype=bool), allowed).tolist() == best.tolist()


def test_a_number_that_cannot_be_negative_stays_out_where_the_data_want_it_negative() -> None:
    J = np.eye(2)
    y = np.array([-6.0, 6.0])
    problem = LinearProblem(
        J.T @ J, J.T @ y, np.full(2, 5.0), np.arange(3), np.array([True, True]), np.zeros(2)
    )  # fmt: skip
    both = np.ones(2, dtype=bool)
    assert best_set(problem, both, both).tolist() == [False, True]
    assert problem.estimate(both)[0].tolist()[0] == 0.0
