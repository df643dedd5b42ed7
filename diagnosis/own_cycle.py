"""When within the PLC's cycles a late datagram took effect: rows that come less often leave a delay a cycle or two.

The link's own cost is flat there, but a course of the reference between rows that is a cycle early makes commands of
all joints a little too large: what is left would be called a flow gain of half a percent on each quiet joint.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from diagnosis.candidates import put
from diagnosis.cells_dynamic import stage_cells
from diagnosis.fit import Fit, costs, evaluated, neutral_fit
from diagnosis.replay import Replayer
from diagnosis.search import Search
from diagnosis.stretches import Stretch
from machine.effects.layout import ParameterSets
from machine.rotations import Array

AROUND = np.arange(-2.0, 2.25, 0.5)  # cycles
SETTLED = 0.01  # cycles
EQUAL_NATS = 1.0
UNEQUAL = 1e9  # more than any sum of logarithms
COST_MIN = 1.0


def at_its_cycle(found: Search, replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets) -> Search:
    """The link's search with the chosen delay where it leaves least of all actuators.

    Model: within what the link's rows cannot tell from the delay found, the smallest sum over joints of the logarithm
           of what stays with no name: a joint with a fault of its own says no more than any other.
    """
    fit = found.chosen.fit
    at, cycle_s = _delay(fit)
    if at is None or not found.cell.coarse:
        return found

    def left(shift: float) -> float:
        theta = _shifted(fit, at, shift * cycle_s)
        worse = float(costs(evaluated(found.cell, fit.hypothesis, theta[None]))[0].sum()) - fit.cost
        if worse > EQUAL_NATS:
            return UNEQUAL
        course = put(base, fit.hypothesis, theta)
        cells = stage_cells("actuator", replayer, stretches, base, course)
        return float(sum(np.log(max(neutral_fit(one).cost, COST_MIN)) for one in cells))

    theta = _shifted(fit, at, _least(left) * cycle_s)
    chosen = replace(found.chosen, fit=replace(fit, theta=theta))
    scored = tuple(chosen if one is found.chosen else one for one in found.scored)
    return replace(found, chosen=chosen, scored=scored)


def _delay(fit: Fit) -> tuple[int | None, float]:
    """Where in theta a delay stands, and the PLC's cycle [s]; None if none was chosen."""
    return next(((here.start, one.cycles[0]) for one, here in fit.slices if one.cycles is not None), (None, 0.0))


def _shifted(fit: Fit, at: int, shift_s: float) -> Array:
    theta = fit.theta.copy()
    theta[at] = max(theta[at] + shift_s, 0.0)
    return theta


def _least(left: Callable[[float], float]) -> float:
    """The shift [cycles] that leaves least: on a grid, then between its neighbours."""
    tried = np.array([left(shift) for shift in AROUND])
    best = int(np.argmin(tried))
    low, high = AROUND[max(best - 1, 0)], AROUND[min(best + 1, len(AROUND) - 1)]
    finer = minimize_scalar(left, bounds=(low, high), method="bounded", options={"xatol": SETTLED})
    return float(finer.x) if finer.fun < tried[best] else float(AROUND[best])
