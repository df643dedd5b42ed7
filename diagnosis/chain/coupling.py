"""The actuators as one cell, where the pump's sharing explains what single joints do not, and what shows beside it."""

from dataclasses import replace

from diagnosis.chain.guessed_noise import searched
from diagnosis.search.candidates import DROOP, Candidate
from diagnosis.search.cell import Cell
from diagnosis.search.fit import costs, evaluated
from diagnosis.search.further import ENUMERATED, one_more
from diagnosis.search.options import options_settled
from diagnosis.search.scan import Scan
from diagnosis.search.score import better
from diagnosis.search.search import Search, backward, known_of
from diagnosis.search.several import Book

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
    least = max([together.cell.least_nats, *(one.cell.least_nats for one in searches)])
    cell = replace(together.cell, least_nats=least)
    book, beside = Book(cell, known_of(together.scored)), _beside(together, searches)
    changes = [(one.candidate, one.thetas[0], one.column) for one in beside if one.column is not None]
    chosen = together.chosen
    while len(chosen.fit.hypothesis) < ENUMERATED:
        found = one_more(book.scored, changes, chosen)
        if not found or not better(found[0], chosen, together.none, together.spread, cell):
            break
        chosen = found[0]
    chosen = backward(book, options_settled(book.scored, chosen), together.spread)
    known = {one.candidate.key for one in together.scans}
    scans = (*together.scans, *(one for one in beside if one.candidate.key not in known))
    return replace(together, scans=scans, scored=tuple(book.known.values()), chosen=chosen)


def _beside(together: Search, searches: list[Search]) -> list[Scan]:
    """What each joint's effects do to the whole cell, at the size that is felt."""
    none, out = together.none.fit.residual, []
    for own in (scan for one in searches for scan in one.scans if scan.felt is not None):
        theta = own.thetas[own.felt]
        residual = evaluated(together.cell, (own.candidate,), theta[None])[0]
        change = residual - none
        out.append(Scan(own.candidate, theta[None], costs(residual).sum()[None], (change @ change)[None], 0, change))
    return out
