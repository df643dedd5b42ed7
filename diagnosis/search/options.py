"""Which of two laws a valve's effect follows: the definitions leave it open, and data of others hold either."""

import numpy as np

from diagnosis.search.candidates import Candidate, named
from diagnosis.search.cell import DRIVEN_STAGES
from diagnosis.search.further import Scored
from diagnosis.search.score import Score
from machine.effects.registry import effect_of

CLEARLY_NATS = 1.0  # below it the first law stays: beside a flow gain both dead bands are one and the same
ROUNDS = 4


def options_settled(scored: Scored, best: Score) -> Score:
    """A hypothesis with each driven effect by the law that foretells more; by the catalogue's first one if none does.

    Why not by the scan: its sizes are too far apart to tell them.
    """
    for place, one in enumerate(best.fit.hypothesis):
        other = _otherwise(one)
        if other is None:
            continue
        hypothesis = tuple(other if k == place else same for k, same in enumerate(best.fit.hypothesis))
        tried = scored(hypothesis, np.array(best.fit.theta), ROUNDS)
        if tried.total - best.total > (-CLEARLY_NATS if _is_first(other) else CLEARLY_NATS):
            best = tried
    return best


def _otherwise(one: Candidate) -> Candidate | None:
    """The same effect by its other law; None where there is one only, or where options are quantities of their own."""
    if not one.option or one.joint is None or one.stage not in DRIVEN_STAGES:
        return None
    return next((other for other in named((one.name,), (one.joint,)) if other.option != one.option), None)


def _is_first(one: Candidate) -> bool:
    choice = effect_of(one.name).choice
    return choice is not None and choice.options[0] == one.option
