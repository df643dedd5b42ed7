"""Which effects one cell's residual asks for: all singles, all pairs by screening, triples by forward steps."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise

import numpy as np

from diagnosis.candidates import Candidate, beside
from diagnosis.cells import DRIVEN_STAGES, Cell
from diagnosis.fit import Fit, Hypothesis, bounds, costs, evaluated, fit, neutral_fit, weights
from diagnosis.further import asked_more, one_more, steps_further, swapped
from diagnosis.margin import MARGIN_NATS
from diagnosis.rare import with_the_event_cut
from diagnosis.score import Score, better, chosen_nats, score
from machine.effects.layout import Slot
from machine.rotations import Array

SCAN_GAIN_NATS = 1.0  # a candidate whose best scanned size gains less is not fitted: it cannot reach the margin
SINGLES_MAX = 16  # fitted, the best of the scan
PAIRS_REFINED = 5
TRIPLES_REFINED = 2
FORESEEN = 2  # sizes tried beyond the grid, where the grid's own changes point
LIMITS_BETWEEN = 20  # sizes of a limit tried where it begins to be felt
FELT = 100.0  # change of the residual, squared floors
REFINED = 10  # sizes tried on either side of a scan's best
PAYLOAD = "payload_error"
YIELDING = ("gravity_sag", "base_compliance")  # to gravity
PAIRS_BURDENED = 2
SOFTER = (0.4, 0.6, 0.8, 1.2, 1.6)  # of the compliance that explains most without another weight
ROUNDS_BURDENED = 30  # compliance times weight is known far better than either
ROUNDS_SINGLE = 8
ROUNDS_PAIR = 6
Key = tuple[str, int | None]


@dataclass(frozen=True, slots=True)
class Scan:
    """A candidate at several sizes: where (m, k), its cost at each (m,), and |change of the residual|^2 (m,).

    `felt`: number of the smallest size that is felt, whatever the residual; None where none is. `column`: the change
    (N,) there.
    """

    candidate: Candidate
    thetas: Array
    costs: Array
    energy: Array
    felt: int | None
    column: Array | None

    @property
    def best(self) -> int:
        """Number of the best size."""
        return int(np.argmin(self.costs))


@dataclass(frozen=True, slots=True)
class Search:
    """What was tried in one cell. `chosen` passed the margin; `spread`: chi2/n of the best model, at least 1."""

    cell: Cell
    scans: tuple[Scan, ...]
    none: Score
    scored: tuple[Score, ...]
    chosen: Score
    spread: float


@dataclass(slots=True)
class _Book:
    """Scores by hypothesis, so that nothing is fitted twice."""

    cell: Cell
    known: dict[frozenset[Key], Score] = field(default_factory=dict)

    def scored(self, hypothesis: Hypothesis, start: Array, rounds: int) -> Score:
        key = frozenset(one.key for one in hypothesis)
        if key not in self.known:
            self.known[key] = score(self.cell, fit(self.cell, hypothesis, start, rounds))
        return self.known[key]


def search(cell: Cell, further: bool = True) -> Search:
    """Search one cell. `further`: for more than three names, too, where no baseline is known.

    Model: every candidate is scanned over its range; those that gain are fitted; all pairs of fitted singles are
           screened by their finite columns, the best refined; triples go on from the best pair; further names, if any
           was found, one by one with exchanges; then one backward pass.
    """
    cell = replace(cell, candidates=beside(cell.base, cell.candidates))
    nothing = neutral_fit(cell)
    cell = with_the_event_cut(cell, nothing.residual)
    none = score(cell, nothing)
    scans = _variants_settled([scan(cell, one, none.fit) for one in cell.candidates])
    return _searched(cell, none, scans, {}, further)


def searched_again(found: Search, least_nats: float) -> Search:
    """The same search by a higher margin: nothing is fitted twice."""
    return _searched(replace(found.cell, least_nats=least_nats), found.none, list(found.scans), _by_keys(found.scored))


def searched_without(found: Search, name: str) -> Search:
    """The same search with one effect taken out of the library: what was fitted without it is not fitted again."""
    cell = replace(found.cell, candidates=tuple(one for one in found.cell.candidates if one.name != name))
    scans = [one for one in found.scans if one.candidate.name != name]
    kept = [score for score in found.scored if all(one.name != name for one in score.fit.hypothesis)]
    return _searched(cell, found.none, scans, _by_keys(kept))


def _by_keys(scored: Iterable[Score]) -> dict[frozenset[Key], Score]:
    return {frozenset(one.key for one in score.fit.hypothesis): score for score in scored}


def _searched(
    cell: Cell, none: Score, scans: list[Scan], known: dict[frozenset[Key], Score], further: bool = True
) -> Search:
    book = _Book(cell, {**known, frozenset(): none})
    singles = _singles(book, scans, none)
    pairs = sorted(_pairs(book, singles, none) + _burdened(book, singles), key=lambda one: -one.total)
    triples = _triples(book, singles, pairs)
    levels = [level for level in (singles, pairs, triples) if level]
    chosen, spread = _best_that_passes(book, levels)
    if further and chosen is not none and steps_further(cell):
        levels += _further(book, scans, levels)
        chosen, spread = _best_that_passes(book, levels)
    chosen = _backward(book, chosen, spread)
    if not better(chosen, none, none, spread, cell):  # what is left of a pair has to stand on its own
        chosen = none
    return Search(cell, tuple(scans), none, tuple(book.known.values()), chosen, spread)


def _best_that_passes(book: _Book, levels: list[list[Score]]) -> tuple[Score, float]:
    """Of each level the best, if it beats what was chosen before it; and by what scores were divided."""
    chosen = none = book.known[frozenset()]
    spread = _spread(book.cell, [none, *(one for level in levels for one in level)])
    for level in levels:
        best = _best_of(level, spread)
        if better(best, chosen, none, spread, asked_more(book.cell, best)):
            chosen = best
    return chosen, spread


def _best_of(level: list[Score], spread: float) -> Score:
    return max(level, key=lambda one: one.total - spread * chosen_nats(one.fit))


def _further(book: _Book, scans: list[Scan], levels: list[list[Score]]) -> list[list[Score]]:
    """Name after name, as long as each gains the margin of one by the noise that the fit before it leaves.

    Why not by the noise of the recording: while half of the names are lacking, all that is left looks like noise.
    """
    changes = [
        (one.candidate, one.thetas[one.felt], one.column)
        for one in scans
        if one.felt is not None and one.column is not None
    ]
    out: list[list[Score]] = []
    best = swapped(book.scored, changes, max((one for level in levels for one in level), key=lambda one: one.total))
    out.append([best])
    while found := one_more(book.scored, changes, best):
        following = swapped(book.scored, changes, found[0])
        gained = following.total - best.total
        out.append([following, *found])
        if gained <= MARGIN_NATS * _spread(book.cell, [following]):
            break
        best = following
    return out


def scan(cell: Cell, candidate: Candidate, none: Fit) -> Scan:
    """One candidate over its range, in one kernel call; then where these sizes say that the best one lies.

    Why the second step: the range's smallest size may be ten times what the data show, and then costs more than none.
    """
    thetas = candidate.starts()
    residuals = evaluated(cell, (candidate,), thetas)
    further = foreseen(candidate, thetas, residuals - none.residual, none.residual)
    if len(further):
        thetas = np.concatenate([thetas, further])
        residuals = np.concatenate([residuals, evaluated(cell, (candidate,), further)])
    energy = ((residuals - none.residual) ** 2).sum(axis=1)
    strong = np.nonzero(energy > FELT)[0]
    felt = int(strong[np.argmin(energy[strong])]) if len(strong) else None
    column = residuals[felt] - none.residual if felt is not None else None
    return Scan(candidate, thetas, costs(residuals).sum(axis=1), energy, felt, column)


def foreseen(candidate: Candidate, thetas: Array, changes: Array, r0: Array) -> Array:
    """Further sizes (m, slots): where changes (m, N), taken as linear, leave the least of r0 (N,); of a limit, where it
    begins to be felt.
    """
    slots = candidate.slots
    if slots[0].neutral != 0.0:
        return _first_felt(thetas, changes)
    w = weights(r0)
    if candidate.vector:
        axes = thetas[: len(slots)].sum(axis=1)
        D = changes[: len(slots)].T / axes
        theta = -np.linalg.lstsq(D * np.sqrt(w)[:, None], r0 * np.sqrt(w), rcond=None)[0]
        return np.clip(theta, [one.low for one in slots], [one.high for one in slots])[None]
    if [one.parameter for one in slots[1:]] == ["phase_rad"]:
        return _wave(slots, thetas, changes, r0)
    power = np.maximum((changes**2 * w).sum(axis=1), 1e-30)
    amounts = np.clip(-(changes * w) @ r0 / power, 0.0, 1.5)
    gains = amounts * (-(changes * w) @ r0) - 0.5 * amounts**2 * power
    best = [k for k in np.argsort(-gains)[:FORESEEN] if gains[k] > 0.0 and abs(amounts[k] - 1.0) > 0.1]
    out = thetas[best].copy()
    out[:, 0] *= amounts[best]
    return np.asarray(out, dtype=float)


def _first_felt(thetas: Array, changes: Array) -> Array:
    """Sizes (m, slots) of a limit between the largest one that changes much and the smallest that changes nothing,
    which is beyond all that was commanded: a limit that cuts a tenth off the fastest moves lies between two sizes of
    the range. One that cuts a jump of a late packet changes something, too, but not much.
    """
    energy = (changes**2).sum(axis=1)
    felt = energy > 0.0
    if not felt.any() or felt.all():
        return np.zeros((0, thetas.shape[1]))
    much = energy > FELT
    low, high = thetas[much if much.any() else felt].max(axis=0), thetas[~felt].min(axis=0)
    return np.geomspace(low, high, LIMITS_BETWEEN + 2)[1:-1]


def _wave(slots: tuple[Slot, ...], thetas: Array, changes: Array, r0: Array) -> Array:
    """The amplitude and phase (1, 2) of a wave that leave the least of r0, by the changes of the smallest amplitude.

    Model: a sin(x + p) = a cos p sin x + a sin p cos x is linear in (a cos p, a sin p).
    Why:   four phases are up to 0.8 rad from the wave's own, where two thirds of it are left, and of two orders the
           wrong one with the nearer phase was taken.
    """
    least = thetas[:, 0] == thetas[:, 0].min()
    amplitude, phase = thetas[least].T
    weighed = np.sqrt(weights(r0))
    of_size = amplitude[:, None] * np.stack([np.cos(phase), np.sin(phase)], axis=1)
    waves = np.linalg.lstsq(of_size, changes[least], rcond=None)[0]
    x, y = -np.linalg.lstsq((waves * weighed).T, r0 * weighed, rcond=None)[0]
    theta = np.array([[np.hypot(x, y), np.arctan2(y, x)]])
    return np.clip(theta, [one.low for one in slots], [one.high for one in slots])


def _variants_settled(scans: list[Scan]) -> list[Scan]:
    """The best variant of each effect and joint."""
    best: dict[tuple[str, int | None], Scan] = {}
    for one in scans:
        key = one.candidate.key
        if key not in best or one.costs[one.best] < best[key].costs[best[key].best]:
            best[key] = one
    return list(best.values())


def _singles(book: _Book, scans: list[Scan], none: Score) -> list[Score]:
    found = []
    promising = sorted(scans, key=lambda one: one.costs[one.best])[:SINGLES_MAX]
    for one in promising:
        if none.fit.cost - one.costs[one.best] > SCAN_GAIN_NATS:
            found.append(book.scored((one.candidate,), _refined(book.cell, one), ROUNDS_SINGLE))
    return sorted(found, key=lambda one: -one.total)


def _refined(cell: Cell, one: Scan) -> Array:
    """A start between the scan's best size and its neighbours, twice: a delay's cost has steps that no gradient sees,
    and stiction's valley is a tenth as wide as its way there.
    """
    best = one.thetas[one.best]
    if len(best) > 1 or cell.stage not in DRIVEN_STAGES:
        return best
    slot = one.candidate.slots[0]
    sizes, found = np.unique(np.append(one.thetas[:, 0], slot.highest)), float(best[0])
    for _ in range(2):
        at = int(np.searchsorted(sizes, found))
        edges = [sizes[max(at - 1, 0)], found, sizes[min(at + 1, len(sizes) - 1)]]
        sizes = np.unique(np.concatenate([np.linspace(a, b, REFINED) for a, b in pairwise(edges)]))
        total = costs(evaluated(cell, (one.candidate,), sizes[:, None])).sum(axis=1)
        found = float(sizes[int(np.argmin(total))])
    return np.array([found])


def _pairs(book: _Book, singles: list[Score], none: Score) -> list[Score]:
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


def _burdened(book: _Book, singles: list[Score]) -> list[Score]:
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


def _triples(book: _Book, singles: list[Score], pairs: list[Score]) -> list[Score]:
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


def _backward(book: _Book, chosen: Score, spread: float) -> Score:
    """Drop each effect that the rest does not need by the margin."""
    hypothesis = chosen.fit.hypothesis
    if len(hypothesis) < 2:
        return chosen
    for out in hypothesis:
        rest = tuple(one for one in hypothesis if one is not out)
        keep = np.concatenate([np.full(len(one.slots), one is not out) for one in hypothesis])
        smaller = book.scored(rest, chosen.fit.theta[keep], ROUNDS_PAIR)
        if not better(chosen, smaller, book.known[frozenset()], spread, book.cell):
            return _backward(book, smaller, spread)
    return chosen


def _spread(cell: Cell, scored: list[Score]) -> float:
    """chi2/n of the best model over all rows, at least 1: a floor that is too low must not sharpen anything."""
    best = max(scored, key=lambda one: one.total)
    return max(1.0, cell.spread_least, 2.0 * -best.total / len(best.held_out))
