"""The actuators as one cell, where the pump's sharing explains what single joints do not, and what shows beside it."""

from dataclasses import replace

from diagnosis.candidates import DROOP, Candidate
from diagnosis.cells import Cell
from diagnosis.fit import evaluated
from diagnosis.further import ENUMERATED, Change, one_more
from diagnosis.guessed_noise import searched
from diagnosis.score import better
from diagnosis.search import Search
from diagnosis.several import Book

SINGLES = 2  # of each joint, besides what was chosen there, that are searched again beside supply_droop


def with_coupling(searches: list[Search], coupled: Cell | None) -> list[Search]:
    """The actuators' searches, or one of them together where supply_droop is found and gains more than all of them."""
    if coupled is None:
        return searches
    alone = searched(coupled)
    if not alone.chosen.fit.hypothesis:
        return searches
    others = {one.key: one for found in searches for one in _likely(found)}
    together = searched(replace(coupled, candidates=(*coupled.candidates, *others.values())))
    if not any(one.name == DROOP for one in together.chosen.fit.hypothesis):
        return searches
    if together.chosen.total <= sum(one.chosen.total for one in searches):
        return searches
    return [with_more(together, searches)]


def _likely(found: Search) -> list[Candidate]:
    singles = [one for one in found.scored if len(one.fit.hypothesis) == 1]
    singles.sort(key=lambda one: -one.total)
    best = [effect for one in singles[:SINGLES] for effect in one.fit.hypothesis]
    return [*found.chosen.fit.hypothesis, *best]


def with_more(together: Search, searches: list[Search]) -> Search:
    """All actuators' search, with what gains the margin beside the names chosen there, of all that joints could have.

    Why: a dead band behind a pump that gives a quarter of what is asked gains nothing as the only name.
    """
    cell, book = together.cell, Book(together.cell)
    changes, chosen = _changes(together, searches), together.chosen
    while len(chosen.fit.hypothesis) < ENUMERATED:
        found = one_more(book.scored, changes, chosen)
        if not found or not better(found[0], chosen, together.none, together.spread, cell):
            break
        chosen = found[0]
    return replace(together, scored=(*together.scored, *book.known.values()), chosen=chosen)


def _changes(together: Search, searches: list[Search]) -> list[Change]:
    """What each joint's effects do to the whole cell, by the size that is felt."""
    at = [(scan.candidate, scan.thetas[scan.felt]) for one in searches for scan in one.scans if scan.felt is not None]
    nothing = together.none.fit.residual
    return [(one, theta, evaluated(together.cell, (one,), theta[None])[0] - nothing) for one, theta in at]
