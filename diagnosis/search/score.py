"""How well a fit foretells what it was not fitted to: held-out block scores, paired margin, log evidence."""

from dataclasses import dataclass

import numpy as np

from diagnosis.search.cell import FORM_SHARE, Cell
from diagnosis.search.fit import Fit, costs, spans, weights
from diagnosis.search.folds import Folds, refitted
from diagnosis.search.margin import MARGIN_MORE_NATS, MARGIN_NATS
from machine.rotations import Array

MARGIN_SE = 1.5
MARGIN_SE_SMALL = 2.0  # below CLEAR_NATS: a swing of one motion gains as much as a small effect, but not everywhere
STICKS = "stiction"
FORM_SHARE_STUCK = 0.3  # what oil and boom do after each jump of a joint that sticks is in no form: up to 0.25
TOUCHED_MIN = 2  # blocks
TOUCHED_SHARE = 0.5
FAINT_NATS = 0.5  # of a block after which a loop has nearly forgotten that its command was limited
CLEAR_NATS = 30.0  # a command limited in a few blocks gains more than that in each


@dataclass(frozen=True, slots=True)
class Score:
    """A fit, where it would have ended without each fold, the held-out residuals (N,), score by block (blocks,) [nats]
    and log evidence [nats].
    """

    fit: Fit
    folds: Folds
    held_out: Array
    by_block: Array
    evidence: float

    @property
    def total(self) -> float:
        """Held-out log score [nats]."""
        return float(self.by_block.sum())


@dataclass(frozen=True, slots=True)
class Compared:
    """A cell without effects and with those found, both on held-out data."""

    cell: Cell
    none: Score
    chosen: Score


def score(cell: Cell, found: Fit) -> Score:
    """Leave each fold (kind of trajectory) out: refit on the rest (`search/folds.py`), then replay it, not linearly."""
    folds, residuals = refitted(cell, found)
    held_out = residuals[np.searchsorted(folds.numbers, cell.rows.fold), np.arange(cell.rows.count)]
    by_block = -np.asarray(np.bincount(cell.rows.block, weights=costs(held_out)), dtype=float)
    return Score(found, folds, held_out, by_block, log_evidence(found))


def better(one: Score, other: Score, none: Score, spread: float = 1.0, cell: Cell | None = None) -> bool:
    """Whether `one` beats `other` by the margin: 6 nats, a share of its gain, and 2 standard errors over blocks (1.5
    from 30 nats on).

    Where its further names gain more than that on the undisturbed machine, half as much again as they ever did is
    asked for. Neither blocks nor the share are asked about what was read off the log: nothing of it was fitted, and
    three packets may well have been lost in one block. Nor does their spread count where names touch half of them or
    fewer and gain in each: of three fast moves the fastest is cut most.

    `spread`: by how much scores are to be divided first (chi2/n of the best model, where the floor is too low);
    `cell`: where its input is not known well enough for 6 nats, or its model's form, it asks for more.
    """
    gains = (one.by_block - other.by_block) / spread
    more = max(0, numbers_of(one.fit) - numbers_of(other.fit) - 1)
    least, form_share = MARGIN_NATS + MARGIN_MORE_NATS * more, FORM_SHARE
    if cell is not None:
        usual = usual_nats(cell, one.fit) - usual_nats(cell, other.fit)
        least, form_share = max(least + max(usual, 0.0) / spread, cell.least_nats), cell.form_share
        if any(effect.name == STICKS for effect in other.fit.hypothesis):
            form_share = max(form_share, FORM_SHARE_STUCK)
    before = {effect.key for effect in other.fit.hypothesis}
    further = [effect for effect in one.fit.hypothesis if effect.key not in before]
    if further and all(effect.read_off for effect in further):
        return float(gains.sum()) > least
    if float(gains.sum()) <= max(least, form_share * (one.total - none.total) / spread):
        return False
    limits = bool(further) and all(one.slots[0].neutral != 0.0 for one in further) and float(gains.sum()) >= CLEAR_NATS
    touched = gains[np.abs(gains) > (FAINT_NATS if limits else 0.0)]
    if TOUCHED_MIN <= len(touched) <= TOUCHED_SHARE * len(gains) and touched.min() > 0.0:
        return True
    least_se = MARGIN_SE if float(gains.sum()) >= CLEAR_NATS else MARGIN_SE_SMALL
    return float(gains.mean()) > least_se * float(gains.std(ddof=1)) / np.sqrt(len(gains))


def usual_nats(cell: Cell, found: Fit) -> float:
    """What a fit's names gain on the undisturbed machine, beyond the margin [nats, not divided]."""
    return sum(cell.usual_nats(effect, numbers) for effect, numbers in found.by_effect)


def numbers_of(found: Fit) -> int:
    """Numbers that a hypothesis could choose: fitted ones, and those tried one by one."""
    return sum(len(one.slots) + len(one.fixed) for one in found.hypothesis)


def chosen_nats(found: Fit) -> float:
    """What a hypothesis pays for the numbers that it could choose beyond one an effect [nats]."""
    return MARGIN_MORE_NATS * (numbers_of(found) - len(found.hypothesis))


def covariance(found: Fit) -> Array:
    """Of theta (k, k), with the range as a weak prior."""
    H = (found.J * weights(found.residual)[:, None]).T @ found.J + np.diag(1.0 / spans(found.hypothesis) ** 2)
    return np.asarray(np.linalg.pinv(H), dtype=float)


def log_evidence(found: Fit) -> float:
    """Laplace: -cost + log prior + k/2 log 2 pi - 1/2 log det H [nats]."""
    if found.k == 0:
        return -found.cost
    sign, logdet = np.linalg.slogdet(covariance(found))
    spread = 0.5 * logdet if sign > 0 else 0.0
    return -found.cost + _log_prior(found) + 0.5 * found.k * np.log(2.0 * np.pi) + float(spread)


def _log_prior(found: Fit) -> float:
    total, at = 0.0, 0
    for one in found.hypothesis:
        for slot in one.slots:
            value = slot.spec.log_prior(float(found.theta[at]) / slot.scale) - np.log(slot.scale)
            total += value if np.isfinite(value) else -50.0
            at += 1
    return total
