"""Which effects one cell's residual asks for: all singles, all pairs by screening, triples by forward steps."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.search.candidates import SET_BY_HAND, Variant, beside
from diagnosis.search.cell import DRIVEN_STAGES, Cell
from diagnosis.search.fit import neutral_fit
from diagnosis.search.further import Change, asked_more, one_more, steps_further, swapped, swaps
from diagnosis.search.margin import MARGIN_NATS
from diagnosis.search.options import options_settled
from diagnosis.search.rare import with_the_event_cut
from diagnosis.search.scan import Scan, orders_settled, refined, scan, variants_settled
from diagnosis.search.score import Score, better, chosen_nats, score
from diagnosis.search.several import ROUNDS_PAIR, Book, burdened, pairs_of, read_off_beside, triples_of
from diagnosis.search.work import Work

SCAN_GAIN_NATS = 1.0  # a candidate whose best scanned size gains less is not fitted: it cannot reach the margin
SINGLES_MAX = 16  # fitted, the best of the scan
ROUNDS_SINGLE = 8
TILT = "joint_axis_tilt"


@dataclass(frozen=True, slots=True)
class Search:
    """What was tried in one cell. `chosen` passed the margin; `spread`: chi2/n of the best model, at least 1.

    `scans`: of each effect and joint the best variant as the only name; `variants`: the others, too.
    """

    cell: Cell
    scans: tuple[Scan, ...]
    variants: tuple[Scan, ...]
    none: Score
    scored: tuple[Score, ...]
    chosen: Score
    spread: float


def search(cell: Cell, further: bool = True, work: Work | None = None) -> Search:
    """Search one cell. `further`: for more than three names, too, where no baseline is known. `work`: is told of it.

    Model: every candidate is scanned over its range; those that gain are fitted; all pairs of fitted singles are
           screened by their finite columns, the best refined; triples go on from the best pair; further names, if any
           was found, one by one with exchanges; then one backward pass.
    """
    cell = replace(cell, candidates=beside(cell.base, cell.candidates))
    nothing = neutral_fit(cell)
    cell = with_the_event_cut(cell, nothing.residual)
    none, work = score(cell, nothing), work or Work()
    scans = []
    for number, one in enumerate(cell.candidates):
        work.scanned(number / len(cell.candidates))
        scans.append(scan(cell, one, none.fit))
    return _searched(cell, none, orders_settled(scans), {}, further, work)


def searched_again(found: Search, least_nats: float) -> Search:
    """The same search by a higher margin: nothing is fitted twice."""
    return _searched(
        replace(found.cell, least_nats=least_nats), found.none, list(found.variants), known_of(found.scored)
    )


def searched_without(found: Search, name: str) -> Search:
    """The same search with one effect taken out of the library: what was fitted without it is not fitted again."""
    cell = replace(found.cell, candidates=tuple(one for one in found.cell.candidates if one.name != name))
    variants = [one for one in found.variants if one.candidate.name != name]
    kept = [score for score in found.scored if all(one.name != name for one in score.fit.hypothesis)]
    return _searched(cell, found.none, variants, known_of(kept))


def known_of(scored: Iterable[Score]) -> dict[frozenset[Variant], Score]:
    """Scores by hypothesis, as a `Book` keeps them."""
    return {frozenset(one.variant for one in score.fit.hypothesis): score for score in scored}


def _searched(
    cell: Cell,
    none: Score,
    variants: list[Scan],
    known: dict[frozenset[Variant], Score],
    further: bool = True,
    work: Work | None = None,
) -> Search:
    work = work or Work()
    book = Book(cell, {**known, frozenset(): none})
    scans = variants_settled(variants)
    changes = _changes(scans if cell.stage in DRIVEN_STAGES else variants)
    singles = _singles(book, scans, none)
    if singles and singles[0].total - none.total > MARGIN_NATS:
        work.named()
    pairs = [*pairs_of(book, singles, none), *burdened(book, singles), *read_off_beside(book, singles)]
    pairs.sort(key=lambda one: -one.total)
    triples = triples_of(book, singles, pairs)
    levels = [_with_siblings(book, changes, level) for level in (singles, pairs, triples) if level]
    chosen, spread = _best_that_passes(book, levels)
    if further and chosen is not none and steps_further(cell):
        levels += [_with_siblings(book, changes, level) for level in _further(book, changes, levels, work)]
        chosen, spread = _best_that_passes(book, levels)
    chosen = backward(book, chosen, spread)
    if cell.stage in DRIVEN_STAGES:
        chosen = options_settled(book.scored, chosen)
    if not better(chosen, none, none, spread, cell):  # what is left of a pair has to stand on its own
        chosen = none
    if len(chosen.fit.hypothesis) > 1:  # a zero that is off looks like the next axis' tilt, and is the likelier one
        swaps(book.scored, [one for one in changes if one[0].name in SET_BY_HAND], chosen, TILT)
    return Search(cell, tuple(scans), tuple(variants), none, tuple(book.known.values()), chosen, spread)


def _best_that_passes(book: Book, levels: list[list[Score]]) -> tuple[Score, float]:
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


def _changes(variants: list[Scan]) -> list[Change]:
    return [
        (one.candidate, one.thetas[one.felt], one.column)
        for one in variants
        if one.felt is not None and one.column is not None
    ]


def _with_siblings(book: Book, changes: list[Change], level: list[Score]) -> list[Score]:
    """A level whose best hypothesis may exchange an effect's variant for another one.

    Why: beside a joint's zero that is off, an error of d is best told as one of a, as long as it is the only name.
    """
    best = level[0]
    if book.cell.stage in DRIVEN_STAGES:
        better = options_settled(book.scored, best)
        return level if better is best else [better, *level]
    if len(best.fit.hypothesis) < 2:
        return level
    keys = {one.key for one in best.fit.hypothesis}
    better = swapped(book.scored, [one for one in changes if one[0].key in keys], best)
    return level if better is best else [better, *level]


def _further(book: Book, changes: list[Change], levels: list[list[Score]], work: Work) -> list[list[Score]]:
    """Name after name, as long as each gains the margin of one by the noise that the fit before it leaves.

    Why not by the noise of the recording: while half of the names are lacking, all that is left looks like noise.
    """
    out: list[list[Score]] = []
    best = swapped(book.scored, changes, max((one for level in levels for one in level), key=lambda one: one.total))
    out.append([best])
    while found := one_more(book.scored, changes, best):
        work.one_more()
        following = swapped(book.scored, changes, found[0])
        gained = following.total - best.total
        out.append([following, *found])
        if gained <= MARGIN_NATS * _spread(book.cell, [following]):
            break
        best = following
    return out


def _singles(book: Book, scans: list[Scan], none: Score) -> list[Score]:
    found = []
    promising = sorted(scans, key=lambda one: one.costs[one.best])[:SINGLES_MAX]
    for one in promising:
        if none.fit.cost - one.costs[one.best] > SCAN_GAIN_NATS:
            found.append(book.scored((one.candidate,), refined(book.cell, one), ROUNDS_SINGLE))
    return sorted(found, key=lambda one: -one.total)


def backward(book: Book, chosen: Score, spread: float) -> Score:
    """Drop each effect that the rest does not need by the margin."""
    hypothesis = chosen.fit.hypothesis
    if len(hypothesis) < 2:
        return chosen
    for out in hypothesis:
        rest = tuple(one for one in hypothesis if one is not out)
        keep = np.concatenate([np.full(len(one.slots), one is not out) for one in hypothesis])
        smaller = book.scored(rest, chosen.fit.theta[keep], ROUNDS_PAIR)
        if not better(chosen, smaller, book.known[frozenset()], spread, book.cell):
            return backward(book, smaller, spread)
    return chosen


def _spread(cell: Cell, scored: list[Score]) -> float:
    """chi2/n of the best model over all rows, at least 1: a floor that is too low must not sharpen anything."""
    best = max(scored, key=lambda one: one.total)
    return max(1.0, cell.spread_least, 2.0 * -best.total / len(best.held_out))
