"""Effects of a machine as it usually is, one after another, while each is worth its margin."""

from dataclasses import replace

import numpy as np

from diagnosis.errors import DiagnosisError
from diagnosis.refusal.remainder import at_edge
from diagnosis.search.candidates import Candidate, put
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, costs, evaluated, fit, neutral_fit
from diagnosis.search.scan import FELT, Scan, foreseen, scan
from diagnosis.search.score import Score, better, score
from diagnosis.search.undoing import undoing
from machine.effects.entries import EffectEntry, make_entry
from machine.effects.registry import effect_of
from machine.errors import MachineFileError
from machine.rotations import Array

EFFECTS_MAX = 9  # in one cell
TRIED = 3  # of the best scanned, fitted at each step
ROUNDS = 5
FEW = 2


def forward(cell: Cell) -> Score:
    """Effects added one by one while they pass the margin, all refitted each time; then dropped where not needed.

    The margin is counted in units of what the best model leaves (chi2/n): a plant's form is never met to the floor. It
    is no share of what is gained in all, as a diagnosis asks: what is small and steady belongs to the machine, too.
    A size at the end of what is believed of it is no usual state: the cause is another one, which has no name. Nor are
    names that undo each other: a gain of 60 % beside an asymmetry of -54 % would put every size of a diagnosis wrong.
    """
    none = chosen = score(cell, neutral_fit(cell))
    scans = [scan(cell, one, none.fit) for one in cell.candidates]
    while len(chosen.fit.hypothesis) < EFFECTS_MAX:
        tried = [_more(cell, chosen, one) for one in _promising(cell, chosen.fit, scans)]
        found = [one for one in tried if not at_edge(cell, one) and not undoing(cell, one.fit, none.fit.residual)]
        best = max(found, key=lambda one: one.total, default=None)
        if best is None or not better(best, chosen, chosen, _left(best)):
            break
        chosen = best
    return _pruned(cell, chosen)


def _left(one: Score) -> float:
    return max(1.0, float(np.mean(np.minimum(one.held_out**2, 100.0))))


def _promising(cell: Cell, found: Fit, scans: list[Scan]) -> list[tuple[Candidate, Array]]:
    """The best candidates on top of a fit, each at a few sizes about what moves the residual by ten floors."""
    used = {one.key for one in found.hypothesis}
    on_top = replace(cell, base=put(cell.base, found.hypothesis, found.theta))
    ranked: list[tuple[float, Candidate, Array]] = []
    for one in scans:
        if one.candidate.key in used:
            continue
        tried = one.thetas
        if found.hypothesis:
            few = _few(one)
            changes = evaluated(on_top, (one.candidate,), few) - found.residual
            tried = np.concatenate([few, foreseen(one.candidate, few, changes, found.residual)])
        totals = costs(evaluated(on_top, (one.candidate,), tried)).sum(axis=1)
        ranked.append((float(totals.min()), one.candidate, tried[int(np.argmin(totals))]))
    ranked.sort(key=lambda row: row[0])
    return [(candidate, theta) for _, candidate, theta in ranked[:TRIED]]


def _few(one: Scan) -> Array:
    """The scan's best size, and on each side of neutral the smallest that moves the residual clearly."""
    if one.candidate.vector:
        return one.thetas
    felt = np.nonzero(one.energy > FELT)[0]
    order = felt[np.argsort(one.energy[felt])][:FEW]
    return one.thetas[np.unique(np.append(order, one.best))]


def _more(cell: Cell, chosen: Score, added: tuple[Candidate, Array]) -> Score:
    candidate, theta = added
    start = np.concatenate([chosen.fit.theta, theta])
    return score(cell, fit(cell, (*chosen.fit.hypothesis, candidate), start, ROUNDS))


def _pruned(cell: Cell, chosen: Score) -> Score:
    for out in chosen.fit.hypothesis[:-1]:
        rest = tuple(one for one in chosen.fit.hypothesis if one is not out)
        keep = np.concatenate([np.full(len(one.slots), one is not out) for one in chosen.fit.hypothesis])
        smaller = score(cell, fit(cell, rest, chosen.fit.theta[keep], ROUNDS))
        if not better(chosen, smaller, smaller, _left(chosen)):
            return _pruned(cell, smaller)
    return chosen


def entries_of(found: Fit) -> list[EffectEntry]:
    """A fit as `[[effect]]` entries; sizes that ended at a bound lie on it."""
    out = []
    for one, values in found.by_effect:
        effect = effect_of(one.name)
        parameters: dict[str, object] = {slot.parameter: value for slot, value in one.fixed}
        if effect.direction is not None:
            size = float(np.linalg.norm(values))
            parameters |= {effect.size.name: min(size, effect.size.highest)}
            if size > 0.0:
                along = np.zeros(len(effect.direction.default))  # a base is tilted about its level axes only
                along[: len(values)] = values / size
                parameters[effect.direction.name] = along.tolist()
        else:
            parameters |= {slot.parameter: float(value) for slot, value in zip(one.slots, values, strict=True)}
        if effect.choice is not None and one.option:
            parameters[effect.choice.name] = one.option
        try:
            out.append(make_entry(effect, one.joint, parameters))
        except MachineFileError as error:
            raise DiagnosisError(f"a fitted effect does not fit its own bounds: {error}") from error
    return out
