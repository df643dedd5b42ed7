"""Which hypotheses a diagnosis leaves open, cell by cell: what a next experiment has to separate."""

from dataclasses import dataclass

import numpy as np

from diagnosis.diagnose import Diagnosis
from diagnosis.experiments.prediction import Hypothesis, held
from diagnosis.search.candidates import Candidate
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, fit
from diagnosis.search.score import Score
from diagnosis.verdict.cell_answer import CellAnswer
from diagnosis.verdict.weigh import Key

LIVE_MIN = 0.01  # probability of the less likely of two
RIVALS_MAX = 3  # of one hypothesis
ROUNDS = 6
CLASS_WEIGHT = 0.05  # of a name that a class holds, whatever probability its penalty left it


@dataclass(frozen=True, slots=True)
class Pair:
    """Two hypotheses of one cell, how much their difference matters, and the effects that differ.

    `spread`: by how much the cell's scores are to be divided.
    """

    cell: Cell
    spread: float
    mine: Hypothesis
    other: Hypothesis
    weight: float
    names: tuple[Key | None, Key | None]


def live_pairs(found: Diagnosis) -> list[list[Pair]]:
    """The open pairs by cell, the weightiest first; none where nothing is open."""
    cells = [pairs for one in found.cells if (pairs := _of_cell(one))]
    return sorted(cells, key=lambda pairs: -pairs[0].weight)


def _of_cell(one: CellAnswer) -> list[Pair]:
    spread, top = one.search.spread, one.weighed[0]
    rivals: dict[frozenset[Key], tuple[Fit, float]] = {}
    for weighed in one.weighed[1:]:
        if weighed.probability >= LIVE_MIN:
            rivals[_keys(weighed.score.fit)] = (weighed.score.fit, weighed.probability)
    for members in one.same:
        for key in members[1:]:
            swapped = _swapped(one, members[0], key)
            if swapped is not None and _keys(swapped) not in rivals:
                rivals[_keys(swapped)] = (swapped, CLASS_WEIGHT)
    mine = held(top.score.fit, spread)
    pairs = [
        Pair(
            one.search.cell,
            spread,
            mine,
            held(other, spread),
            top.probability * weight,
            differing(top.score.fit, other),
        )
        for other, weight in rivals.values()
    ]
    return sorted(pairs, key=lambda pair: -pair.weight)[:RIVALS_MAX]


def _keys(found: Fit) -> frozenset[Key]:
    return frozenset(one.key for one in found.hypothesis)


def _swapped(one: CellAnswer, out: Key, into: Key) -> Fit | None:
    """The first hypothesis with one name exchanged for another, fitted; None where it does not hold the first name."""
    first = one.weighed[0].score.fit
    if out not in _keys(first) or into in _keys(first):
        return None
    known = next((s.fit for s in _scored(one) if _keys(s.fit) == (_keys(first) - {out}) | {into}), None)
    if known is not None:
        return known
    scan = next((scan for scan in one.search.scans if scan.candidate.key == into), None)
    if scan is None:
        return None
    rest: tuple[Candidate, ...] = tuple(c for c in first.hypothesis if c.key != out)
    kept = [theta for candidate, theta in first.by_effect if candidate.key != out]
    return fit(one.search.cell, (*rest, scan.candidate), np.concatenate([*kept, scan.thetas[scan.best]]), ROUNDS)


def _scored(one: CellAnswer) -> tuple[Score, ...]:
    return one.search.scored


def differing(a: Fit, b: Fit) -> tuple[Key | None, Key | None]:
    """The first name that only one of two hypotheses has, each; None where it has none of its own."""
    only_a = [one.key for one in a.hypothesis if one.key not in _keys(b)]
    only_b = [one.key for one in b.hypothesis if one.key not in _keys(a)]
    return (only_a[0] if only_a else None), (only_b[0] if only_b else None)
