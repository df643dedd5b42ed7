"""One candidate over its range: what each size leaves of a cell's residual, and where the best size lies."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from diagnosis.search.candidates import Candidate
from diagnosis.search.cell import DRIVEN_STAGES, Cell
from diagnosis.search.fit import Fit, costs, evaluated, weights
from machine.effects.layout import Slot
from machine.rotations import Array

FORESEEN = 2  # sizes tried beyond the grid, where the grid's own changes point
LIMITS_BETWEEN = 20  # sizes of a limit tried where it begins to be felt
FELT = 100.0  # change of the residual, squared floors
CYCLES_MAX = 300  # cycles tried one by one
TERRACE_CYCLES, TERRACES = 2, 25
REFINED = 10  # sizes tried on either side of a scan's best


@dataclass(frozen=True, slots=True)
class Scan:
    """A candidate at several sizes: where (m, k), its cost at each (m,), and |change of the residual|^2 (m,).

    `felt`: number of the smallest size that is felt, whatever the residual; None where none is. `column`: the change
    (N,) there.
    """

    candidate: Candidate
    thetas: Array
    costs: Array
    energy: Array
    felt: int | None
    column: Array | None

    @property
    def best(self) -> int:
        """Number of the best size."""
        return int(np.argmin(self.costs))


def scan(cell: Cell, candidate: Candidate, none: Fit) -> Scan:
    """One candidate over its range, in one kernel call; then where these sizes say that the best one lies.

    Why the second step: the range's smallest size may be ten times what the data show, and then costs more than none.
    """
    thetas = candidate.starts()
    if cell.coarse and candidate.cycles is not None:
        thetas = np.concatenate([thetas, _on_terraces(candidate.cycles[0])])
    residuals = evaluated(cell, (candidate,), thetas)
    further = foreseen(candidate, thetas, residuals - none.residual, none.residual)
    if len(further):
        thetas = np.concatenate([thetas, further])
        residuals = np.concatenate([residuals, evaluated(cell, (candidate,), further)])
    energy = ((residuals - none.residual) ** 2).sum(axis=1)
    strong = np.nonzero(energy > FELT)[0]
    felt = int(strong[np.argmin(energy[strong])]) if len(strong) else None
    column = residuals[felt] - none.residual if felt is not None else None
    return Scan(candidate, thetas, costs(residuals).sum(axis=1), energy, felt, column)


def _on_terraces(cycle_s: float) -> Array:
    """Further sizes (m, 1) of a delay [s]: between rare rows its cost has terraces as wide as datagrams are apart, and
    the right one may lie between two sizes of the range.
    """
    return TERRACE_CYCLES * cycle_s * np.arange(1.0, TERRACES + 1.0)[:, None]


def foreseen(candidate: Candidate, thetas: Array, changes: Array, r0: Array) -> Array:
    """Further sizes (m, slots): where changes (m, N), taken as linear, leave the least of r0 (N,); of a limit, where it
    begins to be felt.
    """
    slots = candidate.slots
    if slots[0].neutral != 0.0:
        return _first_felt(thetas, changes)
    w = weights(r0)
    if candidate.vector:
        axes = thetas[: len(slots)].sum(axis=1)
        D = changes[: len(slots)].T / axes
        theta = -np.linalg.lstsq(D * np.sqrt(w)[:, None], r0 * np.sqrt(w), rcond=None)[0]
        return np.clip(theta, [one.low for one in slots], [one.high for one in slots])[None]
    if [one.parameter for one in slots[1:]] == ["phase_rad"]:
        return _wave(slots, thetas, changes, r0)
    power = np.maximum((changes**2 * w).sum(axis=1), 1e-30)
    amounts = np.clip(-(changes * w) @ r0 / power, 0.0, 1.5)
    gains = amounts * (-(changes * w) @ r0) - 0.5 * amounts**2 * power
    best = [k for k in np.argsort(-gains)[:FORESEEN] if gains[k] > 0.0 and abs(amounts[k] - 1.0) > 0.1]
    out = thetas[best].copy()
    out[:, 0] *= amounts[best]
    return np.asarray(out, dtype=float)


def _first_felt(thetas: Array, changes: Array) -> Array:
    """Sizes (m, slots) of a limit between the largest one that changes much and the smallest that changes nothing,
    which is beyond all that was commanded: a limit that cuts a tenth off the fastest moves lies between two sizes of
    the range. One that cuts a jump of a late packet changes something, too, but not much.
    """
    energy = (changes**2).sum(axis=1)
    felt = energy > 0.0
    if not felt.any() or felt.all():
        return np.zeros((0, thetas.shape[1]))
    much = energy > FELT
    low, high = thetas[much if much.any() else felt].max(axis=0), thetas[~felt].min(axis=0)
    return np.geomspace(low, high, LIMITS_BETWEEN + 2)[1:-1]


def _wave(slots: tuple[Slot, ...], thetas: Array, changes: Array, r0: Array) -> Array:
    """The amplitude and phase (1, 2) of a wave that leave the least of r0, by the changes of the smallest amplitude.

    Model: a sin(x + p) = a cos p sin x + a sin p cos x is linear in (a cos p, a sin p).
    Why:   four phases are up to 0.8 rad from the wave's own, where two thirds of it are left, and of two orders the
           wrong one with the nearer phase was taken.
    """
    least = thetas[:, 0] == thetas[:, 0].min()
    amplitude, phase = thetas[least].T
    weighed = np.sqrt(weights(r0))
    of_size = amplitude[:, None] * np.stack([np.cos(phase), np.sin(phase)], axis=1)
    waves = np.linalg.lstsq(of_size, changes[least], rcond=None)[0]
    x, y = -np.linalg.lstsq((waves * weighed).T, r0 * weighed, rcond=None)[0]
    theta = np.array([[np.hypot(x, y), np.arctan2(y, x)]])
    return np.clip(theta, [one.low for one in slots], [one.high for one in slots])


def variants_settled(scans: list[Scan]) -> list[Scan]:
    """The best variant of each effect and joint."""
    return _best(scans, lambda one: one.candidate.key)


def orders_settled(scans: list[Scan]) -> list[Scan]:
    """The best order of each wave; a length of a and one of d both stay, and so do tilts about two axes.

    Why not all orders: a dozen waves for every joint explain a little of anything, where poses are few.
    """
    return _best(scans, lambda one: (one.candidate.key, one.candidate.option))


def _best(scans: list[Scan], kind: Callable[[Scan], object]) -> list[Scan]:
    best: dict[object, Scan] = {}
    for one in scans:
        key = kind(one)
        if key not in best or one.costs[one.best] < best[key].costs[best[key].best]:
            best[key] = one
    return list(best.values())


def refined(cell: Cell, one: Scan) -> Array:
    """A start between the scan's best size and its neighbours, twice: a delay's cost has steps that no gradient sees,
    and stiction's valley is a tenth as wide as its way there.
    """
    best = one.thetas[one.best]
    if len(best) > 1 or cell.stage not in DRIVEN_STAGES:
        return best
    slot = one.candidate.slots[0]
    sizes, found = np.unique(np.append(one.thetas[:, 0], slot.highest)), float(best[0])
    if cell.coarse and one.candidate.cycles is not None:
        found = _best_cycle(cell, one.candidate, one.candidate.cycles[0], sizes, found)
        sizes = np.unique(np.append(sizes, found))
    for _ in range(2):
        at = int(np.searchsorted(sizes, found))
        edges = [sizes[max(at - 1, 0)], found, sizes[min(at + 1, len(sizes) - 1)]]
        sizes = np.unique(np.concatenate([np.linspace(a, b, REFINED) for a, b in pairwise(edges)]))
        total = costs(evaluated(cell, (one.candidate,), sizes[:, None])).sum(axis=1)
        found = float(sizes[int(np.argmin(total))])
    return np.array([found])


def _best_cycle(cell: Cell, delay: Candidate, cycle_s: float, sizes: Array, found: float) -> float:
    """The best whole cycle as far as two of a scan's sizes away: rows that come less often give the cost terraces, and
    the end of one was taken for the best size.
    """
    at = int(np.searchsorted(sizes, found))
    low, high = sizes[max(at - 2, 0)], sizes[min(at + 2, len(sizes) - 1)]
    cycles = np.arange(min(int((high - low) / cycle_s), CYCLES_MAX) + 1)
    tried = np.append(np.maximum(delay.settled(low + cycle_s * cycles), 0.0), found)
    total = costs(evaluated(cell, (delay,), tried[:, None])).sum(axis=1)
    return float(tried[int(np.argmin(total))])
