"""What each effect gains on recordings of the undisturbed machine, by chance and by what its model is wrong by."""

import numpy as np

from diagnosis.baseline.left_over import cells_of
from diagnosis.reading.read import Read
from diagnosis.search.cell import DRIVEN_STAGES
from diagnosis.whole_model.linear import Term, linearised
from diagnosis.whole_model.parts import library_of
from diagnosis.whole_model.solve import trusted

Gains = dict[tuple[str, int | None], dict[str, float]]


def usual_gains(checked: list[Read]) -> Gains:
    """By stage and joint, the most that each effect gains when it is the only one [nats], over all recordings.

    What was measured behind the encoders counts as one place, without a joint; so does the link.
    """
    most: Gains = {}
    for cell in (cell for whole in checked for cell in cells_of(whole)):
        terms = tuple(Term(effect, np.zeros(len(effect.slots)), False) for effect in library_of(cell))
        lin = linearised(cell, terms)
        problem = lin.problem(trusted(cell, ()))
        none = problem.score(np.zeros(len(terms), dtype=bool))
        place = cell.stage, cell.joint if cell.stage in DRIVEN_STAGES else None
        gains = most.setdefault(place, {})
        for k, term in enumerate(terms):
            gain = problem.score(np.arange(len(terms)) == k) - none - float(problem.log_odds[k])
            gains[term.effect.name] = max(gains.get(term.effect.name, 0.0), float(gain))
    return most
