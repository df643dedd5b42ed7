"""At which of the PLC's cycles a late datagram took effect: rows that come less often leave a delay a cycle or two.

The link's own cost is flat there, but a course of the reference between rows that is a cycle early makes commands of
all joints a little too large: what is left would be called a flow gain of half a percent on each quiet joint.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.candidates import put
from diagnosis.cells_dynamic import stage_cells
from diagnosis.fit import Fit, costs, evaluated, neutral_fit
from diagnosis.replay import Replayer
from diagnosis.search import Search
from diagnosis.stretches import Stretch
from machine.effects.layout import ParameterSets
from machine.rotations import Array

CYCLES_AROUND = 3
EQUAL_NATS = 1.0
COST_MIN = 1.0


def at_its_cycle(found: Search, replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets) -> Search:
    """The link's search with the chosen delay at the whole cycle that leaves least of all actuators.

    Model: among whole cycles that the link's rows cannot tell from the delay found, the smallest sum over joints of the
           logarithm of what stays with no name: a joint with a fault of its own says no more than any other.
    """
    fit = found.chosen.fit
    thetas = _equal(found, _whole_cycles(fit)) if found.cell.coarse else np.empty((0, fit.k))
    if not len(thetas):
        return found
    tried = np.concatenate([thetas, fit.theta[None]])
    left = [_left(replayer, stretches, base, put(base, fit.hypothesis, theta)) for theta in tried]
    chosen = replace(found.chosen, fit=replace(fit, theta=tried[int(np.argmin(left))]))
    scored = tuple(chosen if one is found.chosen else one for one in found.scored)
    return replace(found, chosen=chosen, scored=scored)


def _whole_cycles(fit: Fit) -> Array:
    """Theta (m, k) with the delay at each whole cycle nearby; none if no delay was chosen."""
    at = 0
    for one in fit.hypothesis:
        if one.cycles is not None:
            own = slice(at, at + len(one.slots))
            steps = one.cycles[0] * np.arange(-CYCLES_AROUND, CYCLES_AROUND + 1)
            out = np.tile(fit.theta, (len(steps), 1))
            out[:, own] = np.clip(one.settled(fit.theta[own]) + steps[:, None], one.slots[0].low, one.slots[0].high)
            return out
        at += len(one.slots)
    return np.empty((0, fit.k))


def _equal(found: Search, thetas: Array) -> Array:
    """Those that the link tells from the delay found by a nat at most."""
    if not len(thetas):
        return thetas
    there = costs(evaluated(found.cell, found.chosen.fit.hypothesis, thetas)).sum(axis=1)
    good: NDArray[np.bool_] = there <= found.chosen.fit.cost + EQUAL_NATS
    return thetas[good]


def _left(replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets, course: ParameterSets) -> float:
    cells = stage_cells("actuator", replayer, stretches, base, course)
    return float(sum(np.log(max(neutral_fit(one).cost, COST_MIN)) for one in cells))
