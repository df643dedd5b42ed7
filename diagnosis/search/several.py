"""Several effects at once in one cell: which pairs and triples are worth a joint fit, and where each fit begins."""

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from diagnosis.search.candidates import Variant
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, Hypothesis, bounds, costs, evaluated, fit
from diagnosis.search.margin import MARGIN_NATS
from diagnosis.search.score import Score, score
from machine.rotations import Array

PAIRS_REFINED = 5
TRIPLES_REFINED = 2
PAYLOAD = "payload_error"
YIELDING = ("gravity_sag", "base_compliance")  # to gravity
PAIRS_BURDENED = 2
PAIRS_READ_OFF = 3
SOFTER = (0.4, 0.6, 0.8, 1.2, 1.6)  # of the compliance that explains most without another weight
ROUNDS_BURDENED = 30  # compliance times weight is known far better than either
ROUNDS_PAIR = 6


@dataclass(slots=True)
class Book:
    """Scores of one cell by hypothesis, so that nothing is fitted twice."""

    cell: Cell
    known: dict[frozenset[Variant], Score] = field(default_factory=dict)

    def scored(self, hypothesis: Hypothesis, start: Array, rounds: int) -> Score:
        """The score of a hypothesis, fitted from `start` unless it is known."""
        key = frozenset(one.variant for one in hypothesis)
        if key not in self.known:
            self.known[key] = score(self.cell, fit(self.cell, hypothesis, start, rounds))
        return self.known[key]


def pairs_of(book: Book, singles: list[Score], none: Score) -> list[Score]:
    """Pairs of fitted singles that could beat the better of the two, refined jointly."""
    if len(singles) < 2:
        return []
    r0 = none.fit.residual
    best_single = max(one.fit.residual @ one.fit.residual for one in singles[:1])
    ranked = []
    for a, b in combinations(singles, 2):
        columns = np.stack([a.fit.residual - r0, b.fit.residual - r0], axis=1)
        amounts, left = _explained(columns, r0)
        ranked.append((left, a, b, amounts))
    ranked.sort(key=lambda row: row[0])
    top = singles[0]
    with_top = [row for row in ranked if row[1] is top or row[2] is top][:2]
    chosen = ranked[:PAIRS_REFINED] + [row for row in with_top if row not in ranked[:PAIRS_REFINED]]
    found = []
    for left, a, b, amounts in chosen:
        if 0.5 * (best_single - left) < -10.0 * MARGIN_NATS:
            continue
        start = _best_start(book.cell, r0, (a, b), amounts)
        found.append(book.scored((*a.fit.hypothesis, *b.fit.hypothesis), start, ROUNDS_PAIR))
    return sorted(found, key=lambda one: -one.total)


def read_off_beside(book: Book, singles: list[Score]) -> list[Score]:
    """What the log shows, beside the best names: what lost packets do to a late command, they do not do alone."""
    found = []
    for shown in (one for one in book.cell.candidates if one.read_off):
        others = [one for one in singles if one.fit.hypothesis[0].key != shown.key]
        for one in others[:PAIRS_READ_OFF]:
            start = np.append(one.fit.theta, shown.starts()[0])
            found.append(book.scored((*one.fit.hypothesis, shown), start, ROUNDS_PAIR))
    return found


def burdened(book: Book, singles: list[Score]) -> list[Score]:
    """What yields to gravity, with another weight to carry: on a rigid arm a payload alone moves nothing."""
    payload = next((one for one in book.cell.candidates if one.name == PAYLOAD), None)
    yielding = [one for one in singles if one.fit.hypothesis[0].name in YIELDING][:PAIRS_BURDENED]
    if payload is None:
        return []
    found = []
    for one in yielding:
        hypothesis = (*one.fit.hypothesis, payload)
        grid = [np.append(share * one.fit.theta, mass) for share in SOFTER for mass in payload.starts()[:, 0]]
        starts = np.clip(np.array(grid), *bounds(hypothesis))
        best = int(np.argmin(costs(evaluated(book.cell, hypothesis, starts)).sum(axis=1)))
        found.append(book.scored(hypothesis, starts[best], ROUNDS_BURDENED))
    return found


def _best_start(cell: Cell, r0: Array, singles: tuple[Score, Score], amounts: Array) -> Array:
    """Where a pair's fit begins: both by the linear screen, both as alone, or one as alone and the other by the rest.

    Why: a size in a narrow valley (stiction, a delay) must not be scaled out of it.
    """
    a, b = singles
    columns = [one.fit.residual - r0 for one in singles]
    rest = [_explained(mine[:, None], other.fit.residual)[0][0] for mine, other in zip(columns, (b, a), strict=True)]
    shares = [(amounts[0], amounts[1]), (1.0, 1.0), (1.0, rest[1]), (rest[0], 1.0)]
    starts = np.array([np.concatenate([_scaled(a.fit, x), _scaled(b.fit, y)]) for x, y in shares])
    return starts[int(np.argmin(costs(evaluated(cell, (*a.fit.hypothesis, *b.fit.hypothesis), starts)).sum(axis=1)))]


def _explained(columns: Array, r0: Array) -> tuple[Array, float]:
    """Amounts of the columns that leave the least of r0, and what they leave (one Gauss-Newton step)."""
    amounts = np.asarray(np.linalg.lstsq(columns, -r0, rcond=None)[0], dtype=float)
    left = r0 + columns @ amounts
    return amounts, float(left @ left)


def _scaled(found: Fit, amount: float) -> Array:
    """A single's size times an amount, kept off neutral and inside its own side; shapes and limits stay."""
    theta = found.theta.copy()
    slots = [slot for one in found.hypothesis for slot in one.slots]
    for k, slot in enumerate(slots):
        if slot.neutral == 0.0 and slot.parameter == slots[0].parameter:
            theta[k] *= float(np.clip(amount, 0.1, 2.0)) if amount > 0.0 else 0.1
    return theta


def triples_of(book: Book, singles: list[Score], pairs: list[Score]) -> list[Score]:
    """The best pair with one more single."""
    if not pairs or len(singles) < 3:
        return []
    base = pairs[0]
    names = {one.key for one in base.fit.hypothesis}
    r0 = base.fit.residual
    none = book.known[frozenset()].fit.residual
    ranked = []
    for one in singles:
        if one.fit.hypothesis[0].key not in names:
            column = (one.fit.residual - none)[:, None]
            amounts, left = _explained(column, r0)
            ranked.append((left, one, float(amounts[0])))
    ranked.sort(key=lambda row: row[0])
    found = []
    for left, one, amount in ranked[:TRIPLES_REFINED]:
        if 0.5 * (r0 @ r0 - left) > MARGIN_NATS:
            start = np.concatenate([base.fit.theta, _scaled(one.fit, amount)])
            found.append(book.scored((*base.fit.hypothesis, *one.fit.hypothesis), start, ROUNDS_PAIR))
    return found
