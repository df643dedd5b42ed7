"""Names that answer the noise of a fast loop: what they foretell goes with no command that a reference asks for.

Why: through a fast loop the measured command follows the disturbance that the residual is made of. "Small commands do
nothing" then foretells it: on a sound machine whose gap was within its noise all six joints had a stiction or a
hysteresis.
"""

from collections.abc import Callable
from dataclasses import replace

from diagnosis.families.common import COMMON_LEAST, TOLD_NATS, repeated_rows, share_in_common, share_of
from diagnosis.families.quiet_loop import quiet_loop
from diagnosis.search.score import CLEAR_NATS, Score
from diagnosis.search.search import Search, known_of, searched_again

ROUNDS = 4  # names that are taken back
FAR_NATS = 12.0  # below the best: no probability to speak of, and not looked at
FAINT_NATS = 2.0  # of a name, which no margin lets pass

Share = Callable[[Score, Score], float]


def without_echoes(found: Search) -> Search:
    """The search again by a margin that what only answers the noise does not reach, and without such hypotheses, which
    share no probability; the same where nothing does.
    """
    share = _share(found)
    if share is None:
        return found
    for _ in range(ROUNDS):
        least = _loudest(found, found.chosen, share)
        if least <= 0.0:
            break
        found = searched_again(found, max(found.cell.least_nats, least / found.spread))
    best = max(one.total for one in found.scored)
    kept = (
        one
        for one in found.scored
        if one is found.chosen or one.total < best - FAR_NATS * found.spread or _loudest(found, one, share) <= 0.0
    )
    return replace(found, scored=tuple(kept))


def _share(found: Search) -> Share | None:
    """Of what a score gains beyond another one, the share that is no echo, by a quiet loop, or by repeats; None where
    neither can tell.

    Why both: a joint that sticks jumps at another moment in a loop that nothing disturbs. What repeats have much of in
    common is no echo, but of a few nats chance gives them more than half.
    """
    repeats, quiet = repeated_rows(found.cell), quiet_loop(found.cell)
    if not repeats and quiet is None:
        return None

    def share(one: Score, rest: Score) -> float:
        change = rest.held_out - one.held_out
        told = [share_in_common(rest.held_out, change, repeats, TOLD_NATS if quiet is None else CLEAR_NATS)]
        if quiet is not None:
            told.append(share_of(rest.held_out, change, quiet.change(one, rest)))
        return max((one for one in told if one is not None), default=1.0)

    return share


def _loudest(found: Search, one: Score, share: Share) -> float:
    """The most that a name of a hypothesis gains [nats, not divided] which is an echo; 0 where none is."""
    known, loudest = known_of(found.scored), 0.0
    for name in one.fit.hypothesis:
        rest = known.get(frozenset(other.variant for other in one.fit.hypothesis if other is not name))
        gained = 0.0 if rest is None else one.total - rest.total
        if rest is not None and gained > FAINT_NATS and share(one, rest) < COMMON_LEAST:
            loudest = max(loudest, gained)
    return loudest
