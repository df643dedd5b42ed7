"""Names that answer the noise of a fast loop: what they foretell is not what repeats of one command have in common.

Why: through a fast loop the measured command follows the disturbance that the residual is made of. "Small commands do
nothing" then foretells it: on a sound machine whose gap was within its noise all six joints had a stiction or a
hysteresis.
"""

from dataclasses import replace

from diagnosis.families.common import COMMON_LEAST, Numbers, common_share, repeated_rows
from diagnosis.search.score import Score
from diagnosis.search.search import Search, known_of, searched_again

ROUNDS = 4  # names that are taken back


def without_echoes(found: Search) -> Search:
    """The search again by a margin that what only answers the noise does not reach, and without such hypotheses, which
    share no probability; the same where nothing does.
    """
    repeats = repeated_rows(found.cell)
    if not repeats:
        return found
    for _ in range(ROUNDS):
        least = _loudest(found, found.chosen, repeats)
        if least <= 0.0:
            break
        found = searched_again(found, max(found.cell.least_nats, least / found.spread))
    kept = (one for one in found.scored if one is found.chosen or _loudest(found, one, repeats) <= 0.0)
    return replace(found, scored=tuple(kept))


def _loudest(found: Search, one: Score, repeats: list[Numbers]) -> float:
    """The most that a name of a hypothesis gains [nats, not divided] which is no gain in common; 0 where none is."""
    known, loudest = known_of(found.scored), 0.0
    for name in one.fit.hypothesis:
        rest = known.get(frozenset(other.variant for other in one.fit.hypothesis if other is not name))
        if rest is not None and common_share(rest.held_out, rest.held_out - one.held_out, repeats) < COMMON_LEAST:
            loudest = max(loudest, one.total - rest.total)
    return loudest
