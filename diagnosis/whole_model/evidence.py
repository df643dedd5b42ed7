"""The evidence of each effect of the best set: gain, size against its uncertainty, invariance, rivals, remainder."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.cell import Cell
from diagnosis.search.fit import costs
from diagnosis.whole_model.linear import Term, linearised
from diagnosis.whole_model.solve import Fitted, WholeFit, alike_delays
from machine.rotations import Array

QUANTILE_95 = 1.6448536269514722
FOUND_90_OF_98 = 3.3354  # deviations: found with 90 % probability at 2 % false alarms
RANK = 1e-6  # of the largest power: below, columns of finite steps are the same to rounding
QUARTERS, HALVES = (0.25, 0.5, 0.75), (0.5,)
EQUAL_T = 9.0  # least squared distance below which two sets are not distinguished (contract)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for one effect of the best set of its part.

    `gain_nats`: what the best set without it loses. `sd`: (slots,) of its numbers, with what its definition leaves
    open. `z`: its size over that. `scatter`: by what share its size differs between kinds of motion, times, amplitudes
    or postures, beyond noise; a cause has one size. `equals`: sets of effects that take its place at a distance T
    below 9. `left`: mean squared residual of its part in noise floors. `noise_known`: from repeats or stated accuracy.
    """

    term: Term
    part: str
    gain_nats: float
    sd: Array
    z: float
    scatter: float
    equals: tuple[tuple[Term, ...], ...]
    left: float
    noise_known: bool

    @property
    def limits(self) -> tuple[Array, Array]:
        """90 % limits of its numbers (slots,)."""
        slots = self.term.effect.slots
        half = QUANTILE_95 * self.sd
        low, high = np.array([slot.low for slot in slots]), np.array([slot.highest for slot in slots])
        return np.maximum(self.term.theta - half, low), np.minimum(self.term.theta + half, high)


def evidence_of(fit: WholeFit) -> tuple[Evidence, ...]:
    """The evidence of every present effect of a part.

    Why tangents, of thresholds, too: deviations and the score test belong to the slope at the best numbers. The secant
    back to absence, by which a set is judged, has a score of its own there.
    """
    best = fit.best
    present = np.nonzero(best.present)[0]
    if not len(present):
        return ()
    lin = linearised(fit.cell, tuple(best.terms[k] for k in present), to_move=True)
    w = lin.weight * fit.trust
    J, residual = lin.J * np.sqrt(w)[:, None], lin.residual * np.sqrt(w)
    spread = deviations(J, residual, lin.slab, fit.cell.rows.together)
    left = float(np.mean(lin.weight * lin.residual**2))
    groupings = groupings_of(fit.cell)
    out = []
    for term, k, own in zip(lin.terms, present, np.split(np.arange(J.shape[1]), lin.first[1:-1]), strict=True):
        sd = _with_open(term, spread[own])
        z = _z(term, sd[: term.sizes])
        if term.effect.cycles is not None:
            run = alike_delays(fit.cell, lin, len(out), fit.trust)
            sd = np.hypot(sd, (float(np.ptp(run)) + term.effect.cycles[0]) / np.sqrt(12.0))
        out.append(
            Evidence(
                term=term,
                part=fit.cell.label,
                gain_nats=_gain(fit, int(k)),
                sd=sd,
                z=z,
                scatter=_share_of_size(term, scatter(J, residual, own[: term.sizes], groupings)),
                equals=_equals(fit, int(k)),
                left=left,
                noise_known=fit.cell.floor_known,
            )
        )
    return tuple(out)


def deviations(J: Array, residual: Array, slab: Array, block: NDArray[np.int64]) -> Array:
    """Standard deviations (k,) of numbers with columns J (N, k) under priors `slab` (k,): by the posterior, and at
    least what leaving out one block of rows after the other moves them by.

    Why: what a model is wrong by in one posture or motion is no white noise; a number that hangs on one shows it.
    Source: delete-one-group jackknife, Kott 2001, eq. 1.
    """
    H, g = J.T @ J + np.diag(slab**-2.0), J.T @ residual
    S = np.asarray(np.linalg.inv(H), dtype=float)
    whole = S @ g
    moved = []
    for number in np.unique(block):
        rows = J[block == number]
        moved.append(np.linalg.solve(H - rows.T @ rows, g - rows.T @ residual[block == number]) - whole)
    jackknife = np.sqrt((np.array(moved) ** 2).sum(axis=0) * (len(moved) - 1.0) / len(moved))
    return np.maximum(np.sqrt(np.maximum(np.diag(S), 0.0)), jackknife)


def _z(term: Term, sd: Array) -> float:
    if term.limits:
        return float("inf")
    return float(np.linalg.norm(term.theta[: term.sizes] / np.maximum(sd, 1e-300)))


def _share_of_size(term: Term, spread: float) -> float:
    size = 1.0 if term.limits else float(np.linalg.norm(term.theta[: term.sizes]))
    return spread / size if size > 0.0 else 0.0


def _with_open(term: Term, sd: Array) -> Array:
    """Deviations (slots,) of a term's numbers, with what the effect's definition leaves open."""
    open_part = [
        max(slot.spec.open_size, slot.spec.open_frac * abs(x))
        for slot, x in zip(term.effect.slots, term.theta, strict=True)
    ]
    return np.hypot(sd, open_part)


def _gain(fit: WholeFit, k: int) -> float:
    rival = fit.rivals.get(k)
    if rival is not None:
        return fit.best.score - rival.score
    problem, members = fit.best.problem, fit.best.present.copy()
    members[k] = False
    return problem.score(fit.best.present) - problem.score(members)


def _equals(fit: WholeFit, k: int) -> tuple[tuple[Term, ...], ...]:
    """What may stand in an effect's place: terms with the same column, and what enters its rival where T is below 9."""
    found: list[tuple[Term, ...]] = [(fit.best.terms[out],) for kept, out in fit.twins if kept == k]
    rival = fit.rivals.get(k)
    if rival is not None:
        distance = 2.0 * float(_cost(rival, fit) - _cost(fit.best, fit))
        entered = tuple(
            one for one, before in zip(rival.terms, fit.best.terms, strict=True) if one.present and not before.present
        )
        if entered and distance < EQUAL_T:
            found.append(entered)
    return tuple(found)


def _cost(one: Fitted, fit: WholeFit) -> float:
    return float((costs(one.lin.residual) * fit.trust).sum())


def scatter(J: Array, residual: Array, own: NDArray[np.int64], groupings: Sequence[NDArray[np.int64]]) -> float:
    """Standard deviation of a size between groups of rows beyond its noise, the largest of the groupings; 0 by chance.

    Model:  a number of their own in every group for columns `own` of J, against all of J common to all; their sum of
            squares d'Wd has the mean df + tau^2 tr W if the sizes scatter by tau (method of moments).
    Why projected: a fit stops short of its optimum and leans on its priors; what J can still explain is no difference.
    Source: invariance as a sign of a cause: Peters, Buehlmann, Meinshausen 2016; tau: DerSimonian, Laird 1986.
    """
    norm = np.sqrt((J**2).sum(axis=0))
    U, sizes, _ = np.linalg.svd(J[:, norm > 0.0] / norm[norm > 0.0], full_matrices=False)
    Q = U[:, sizes > RANK * sizes.max(initial=0.0)]
    return max((_scatter(Q, J[:, own], residual, group) for group in groupings), default=0.0)


def _scatter(Q: Array, columns: Array, residual: Array, group: NDArray[np.int64]) -> float:
    """Of one grouping; Q: orthonormal columns of what is common to all groups."""
    apart = (columns[:, None] * (group[:, None] == np.unique(group))[:, :, None]).reshape(len(residual), -1)
    power = float((apart**2).sum(axis=0).max())
    apart = apart - Q @ (Q.T @ apart)
    values, vectors = np.linalg.eigh(apart.T @ apart)
    kept = values > RANK * power
    if not kept.any():
        return 0.0
    scores = vectors[:, kept].T @ (apart.T @ residual)
    squares, df = float((scores**2 / values[kept]).sum()), int(kept.sum())
    beyond = max(0.0, squares - df - np.sqrt(2.0 * df))  # chance alone does not scatter
    return float(np.sqrt(beyond / values[kept].sum()))


def groupings_of(cell: Cell) -> list[NDArray[np.int64]]:
    """Groups of rows in which a true cause has one size: kinds of motion; of each part quarters of its time, and the
    lower and upper half of whatever a remainder may go with (position, speed, command, posture).
    """
    out, start = [cell.rows.fold], 0
    for part in cell.parts or (cell,):
        own = slice(start, start + part.rows.count)
        start += part.rows.count
        for values, cuts in ((part.t_s, QUARTERS), *((values, HALVES) for _, values in part.regressors)):
            group = np.zeros(cell.rows.count, dtype=np.int64)
            if len(values) == part.rows.count:
                group[own] = 1 + np.searchsorted(np.quantile(values, cuts), values)
            out.append(group)
    return [group for group in out if len(np.unique(group)) > 1]


def detectable(fit: WholeFit) -> dict[int, float]:
    """By absent term, the smallest size that this recording would have shown: found nine times of ten at 2 % alarms."""
    H, best = fit.best.problem.H, fit.best
    cols = np.nonzero(np.repeat(best.present, np.diff(best.lin.first)))[0]
    inside = H[np.ix_(cols, cols)] + np.diag(best.problem.slab[cols] ** -2.0)
    inverse = np.linalg.inv(inside) if len(cols) else np.zeros((0, 0))
    out = {}
    for k, term in enumerate(best.terms):
        if term.present or term.limits:
            continue
        first = int(best.lin.first[k])
        cross = H[first, cols]
        power = float(H[first, first] - cross @ inverse @ cross)
        out[k] = FOUND_90_OF_98 / np.sqrt(power) if power > 1e-9 * max(float(H[first, first]), 1e-300) else np.inf
    return out
