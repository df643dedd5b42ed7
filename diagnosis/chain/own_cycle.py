"""When within the PLC's cycles a datagram took effect: rows that come less often leave a cycle or ten.

The link's own cost is flat there, but a course of the reference between rows that is a cycle early makes commands of
all joints a little too large: what is left would be called a flow gain of half a percent on each quiet joint.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from diagnosis.cells.dynamic import stage_cells
from diagnosis.replay.replayer import Replayer
from diagnosis.replay.stretches import Stretch
from diagnosis.search.candidates import Candidate, put
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, costs, evaluated, neutral_fit
from diagnosis.search.search import Search
from machine.effects.layout import ParameterSets
from machine.rotations import Array

FED = ("controller", "actuator")  # stages whose input is the reference, or what comes of it
SETTLED = 0.01  # cycles
EQUAL_NATS = 1.0
UNEQUAL = 1e9  # more than any sum of logarithms
COST_MIN = 1.0


def at_its_cycle(found: Search, replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets) -> Search:
    """The link's search with the chosen delay where it leaves least of controllers and actuators.

    Model: within what the link's rows cannot tell from the delay found, the smallest sum over joints of the logarithm
           of what stays with no name: a joint with a fault of its own says no more than any other.
    """
    fit = found.chosen.fit
    at, cycle_s = _delay(fit)
    if at is None or not found.cell.coarse:
        return found
    left = _left_by(found, fit.hypothesis, fit.cost, replayer, stretches, base)
    row = _cycles_a_row(stretches, cycle_s)
    settled = np.concatenate([one.settled(fit.theta[here]) for one, here in fit.slices])  # a PLC takes none within
    tried = [fit.theta, *(_later(settled, at, shift * cycle_s) for shift in range(-row, row + 1))]
    theta = _finer(left, min(tried, key=left), at, cycle_s)
    chosen = replace(found.chosen, fit=replace(fit, theta=theta))
    scored = tuple(chosen if one is found.chosen else one for one in found.scored)
    return replace(found, chosen=chosen, scored=scored)


def unseen_wait(
    found: Search, replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets
) -> ParameterSets:
    """The base with a delay that no row shows, where controllers and actuators are left with less by it; none where
    every datagram comes on the dot.

    Why: sent at 100 Hz and logged at 100 Hz, three milliseconds are in no row. No name comes of it: joints may say when
    a command came, but not why.
    """
    delay = next((one for one in found.cell.candidates if one.cycles is not None), None)
    fit = found.chosen.fit
    unsure = any(one.sent is not None and one.sent.unsure_s > 0.0 for one in stretches)
    if delay is None or delay.cycles is None or _delay(fit)[0] is not None or not (found.cell.coarse and unsure):
        return base
    cycle_s = delay.cycles[0]
    left = _left_by(found, (*fit.hypothesis, delay), fit.cost, replayer, stretches, base)
    waits = [np.array([k * cycle_s]) for k in range(_cycles_a_row(stretches, cycle_s) + 1)]
    return put(base, (delay,), min(waits, key=lambda wait: left(np.append(fit.theta, wait))))


def _left_by(
    found: Search,
    hypothesis: tuple[Candidate, ...],
    cost: float,
    replayer: Replayer,
    stretches: tuple[Stretch, ...],
    base: ParameterSets,
) -> Callable[[Array], float]:
    """What the stages it feeds are left with after numbers (k,) of the link; UNEQUAL where its own rows tell them."""

    def left(theta: Array) -> float:
        worse = float(costs(evaluated(found.cell, hypothesis, theta[None]))[0].sum()) - cost
        if worse > EQUAL_NATS:
            return UNEQUAL
        course = put(base, hypothesis, theta)
        cells = [one for stage in FED for one in stage_cells(stage, replayer, stretches, base, course)]
        return left_in(cells)

    return left


def left_in(cells: Sequence[Cell]) -> float:
    """The sum over joints of the logarithm of what stays with no name: a joint with a fault weighs as any other."""
    return float(sum(np.log(max(neutral_fit(one).cost, COST_MIN)) for one in cells))


def _delay(fit: Fit) -> tuple[int | None, float]:
    """Where in theta a delay stands, and the PLC's cycle [s]; None if none was chosen."""
    return next(((here.start, one.cycles[0]) for one, here in fit.slices if one.cycles is not None), (None, 0.0))


def _later(theta: Array, at: int, by_s: float) -> Array:
    """Numbers (k,) with the delay so much longer, none below 0."""
    out = theta.copy()
    out[at] = max(theta[at] + by_s, 0.0)
    return out


def _cycles_a_row(stretches: tuple[Stretch, ...], cycle_s: float) -> int:
    """PLC cycles from one log row to the next."""
    return int(np.ceil(max(one.dt_s for one in stretches) / cycle_s - 1e-6))


def _finer(left: Callable[[Array], float], theta: Array, at: int, cycle_s: float) -> Array:
    """Theta with the delay between two cycles where that leaves less: a mean over datagrams that wait unequally."""

    def by(cycles: float) -> float:
        return left(_later(theta, at, cycles * cycle_s))

    best = minimize_scalar(by, bounds=(-1.0, 1.0), method="bounded", options={"xatol": SETTLED})
    return _later(theta, at, float(best.x) * cycle_s) if best.fun < left(theta) else theta
