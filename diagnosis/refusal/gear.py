"""Waves over the angle of more orders a turn than an encoder's disc has: a gear's, which the catalogue lacks."""

from dataclasses import replace

import numpy as np

from diagnosis.refusal.remainder import EDGE, Fired
from diagnosis.search.candidates import Candidate
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, Hypothesis, costs, evaluated, fit
from diagnosis.search.score import Score

WAVE = "encoder_eccentricity"
ORDERS = (5, 6, 7, 8, 9, 10, 12, 14, 17, 20, 24, 30)
BETTER_NATS = 3.0
ROUNDS = 4
TURNED = np.linspace(-3.0, 3.0, 7)  # phases [rad] from which a wave of another order is sought


def gears(cell: Cell, chosen: Score) -> tuple[Fired, ...]:
    """A refusal where a wave was named by the highest order of the catalogue, and one of more orders fits better."""
    found = []
    for number, effect in enumerate(chosen.fit.hypothesis):
        if effect.name == WAVE and _order(effect) == ORDERS[0] - 1:
            best = _best_gear(cell, chosen.fit, number)
            if best is not None:
                lead = f"waves about {best} times a turn, more often than an encoder's disc"
                found.append(Fired(EDGE, cell.stage, effect.joint, 1.0, 0.0, lead))
    return tuple(found)


def _order(effect: Candidate) -> float:
    return next((value for slot, value in effect.fixed if slot.parameter == "order"), 0.0)


def _best_gear(cell: Cell, known: Fit, number: int) -> int | None:
    """The order that fits best among those of gears; None where the named one does as well."""
    best, least = None, known.cost - BETTER_NATS
    for order in ORDERS:
        hypothesis = _with_order(known.hypothesis, number, float(order))
        found = fit(cell, hypothesis, _start(cell, hypothesis, known, number), ROUNDS)
        if found.cost < least:
            best, least = order, found.cost
    return best


def _with_order(hypothesis: Hypothesis, number: int, order: float) -> Hypothesis:
    """The hypothesis with its wave of another order."""
    wave = hypothesis[number]
    fixed = tuple((slot, order if slot.parameter == "order" else value) for slot, value in wave.fixed)
    return (*hypothesis[:number], replace(wave, fixed=fixed), *hypothesis[number + 1 :])


def _start(cell: Cell, hypothesis: Hypothesis, known: Fit, number: int) -> np.ndarray:
    """The known numbers with the phase that fits best, and half of the amplitude: steeper waves need less."""
    first = sum(len(one.slots) for one in hypothesis[:number])
    names = [slot.parameter for slot in hypothesis[number].slots]
    size, phase = first + names.index("amplitude_rad"), first + names.index("phase_rad")
    starts = np.repeat(known.theta[None], len(TURNED), axis=0)
    starts[:, size] *= 0.5
    starts[:, phase] = TURNED
    return starts[int(np.argmin(costs(evaluated(cell, hypothesis, starts)).sum(axis=1)))]
