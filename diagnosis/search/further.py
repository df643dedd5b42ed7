"""More than three names at once, on a machine whose usual state nobody has recorded: there, many things are a little
off, and every offset of a joint is a name.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.candidates import Candidate
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, Hypothesis, bounds, weights
from diagnosis.search.score import Score
from machine.rotations import Array

Mask = NDArray[np.bool_]
ENUMERATED = 3  # names that the search tries in all their combinations, by screening
NAMES_MAX = 8
UNSURE_NATS = 18.0  # the margin of a name by the temperature of an unknown floor (calibration.json)
REFINED = 3  # of the names that a linear step likes best
ROUNDS = 6
EQUAL_NATS, EQUALS = 0.5, 2  # by which two hypotheses score the same, and how many such are exchanged further
SWAPS_MAX = 4
Scored = Callable[[Hypothesis, Array, int], Score]
Change = tuple[Candidate, Array, Array]  # an effect, its numbers (k,), and what they change of the residual (N,)


def steps_further(cell: Cell) -> bool:
    """Whether more than three names are looked for: where no baseline is known.

    Why not where one is: three faults on one day are one cause that the catalogue lacks.
    """
    return not cell.usual_known


def asked_more(cell: Cell, one: Score) -> Cell:
    """The cell by which a hypothesis is judged: beyond three names, where the noise was never measured, by the margin
    that as many odds ask for there.
    """
    if cell.floor_known or len(one.fit.hypothesis) <= ENUMERATED:
        return cell
    return replace(cell, least_nats=max(cell.least_nats, UNSURE_NATS))


def one_more(scored: Scored, changes: list[Change], best: Score) -> list[Score]:
    """Hypotheses of one name more than `best`, best first.

    Model: each change is laid beside the fit's own columns, all in one least squares; the names that leave the least of
           the residual are fitted jointly, from there.
    """
    names = {effect.key for effect in best.fit.hypothesis}
    if len(names) >= NAMES_MAX:
        return []
    columns = np.full(best.fit.k, True)
    ranked = sorted(_screened(best.fit, columns, best.fit.residual, changes, names), key=lambda row: row[0])
    found = [
        scored((*best.fit.hypothesis, candidate), np.concatenate([best.fit.theta, start]), ROUNDS)
        for _, candidate, start in ranked[:REFINED]
    ]
    return sorted(found, key=lambda one: -one.total)


def swapped(scored: Scored, changes: list[Change], best: Score) -> Score:
    """The best that an exchange of one name for another comes to, again and again.

    Why: what four names do may be taken for two names, a wave and a droop; the fifth then mends that, and no step
         forward ever takes a name back. Nor does any exchange, where an encoder's scale that stood for a flow gain as
         well would have to pass its bound: so what scores the same is exchanged further, too.
    """
    for _ in range(SWAPS_MAX):
        tried = swaps(scored, changes, best)
        equal = [one for one in tried if abs(one.total - best.total) < EQUAL_NATS]
        better = max(tried, key=lambda one: one.total, default=best)
        if better.total <= best.total + EQUAL_NATS:
            beyond = [further for one in equal[:EQUALS] for further in swaps(scored, changes, one)]
            better = max([*beyond, better], key=lambda one: one.total)
        if better.total <= best.total:
            break
        best = better
    return best


def swaps(scored: Scored, changes: list[Change], best: Score, of: str = "") -> list[Score]:
    """The most promising exchanges of one name, fitted. `of`: only of this name."""
    fit = best.fit
    names = {effect.key for effect in fit.hypothesis}
    ranked: list[tuple[float, Candidate, Array, Candidate, Mask]] = []
    for out, own in fit.slices:
        if of not in ("", out.name):
            continue
        mine = np.zeros(fit.k, dtype=bool)
        mine[own] = True
        sizes = np.array([slot.parameter == out.slots[0].parameter and slot.neutral == 0.0 for slot in out.slots])
        alone = fit.J[:, mine] @ np.where(sizes, fit.theta[mine], 0.0)  # its own change, linear in its size
        others = [one for one in changes if one[0].variant != out.variant]
        found = _screened(fit, ~mine, fit.residual - alone, others, names - {out.key})
        ranked += [(left, candidate, start, out, ~mine) for left, candidate, start in found]
    ranked.sort(key=lambda row: row[0])
    tried = []
    for _, candidate, start, out, rest in ranked[:REFINED]:
        kept = tuple(effect for effect in fit.hypothesis if effect is not out)
        tried.append(scored((*kept, candidate), np.concatenate([fit.theta[rest], start]), ROUNDS))
    return tried


def _screened(
    fit: Fit, columns: Mask, residual: Array, changes: list[Change], names: set[tuple[str, int | None]]
) -> list[tuple[float, Candidate, Array]]:
    """What each effect that is not named would leave of a residual (N,) beside these columns of the fit (k,), and where
    its numbers would lie.
    """
    root = np.sqrt(weights(fit.residual))
    own = np.linalg.qr(fit.J[:, columns] * root[:, None])[0]
    r = residual * root
    r = r - own @ (own.T @ r)
    out = []
    for candidate, theta, change in changes:
        beside = change * root
        beside = beside - own @ (own.T @ beside)
        power = float(beside @ beside)
        if candidate.key in names or power <= 0.0:
            continue
        amount = -float(beside @ r) / power
        low, high = bounds((candidate,))
        start = theta.copy()
        start[0] *= amount
        out.append((float(r @ r) - amount**2 * power, candidate, np.clip(start, low, high)))
    return out
