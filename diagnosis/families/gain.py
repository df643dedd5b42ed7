"""What a family of columns foretells of a residual where it was not fitted."""

import math

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.cell import Rows
from diagnosis.search.fit import costs, weights
from machine.rotations import Array

RIDGES = (0.1, 1.0, 10.0, 100.0)  # rows' worth of prior on each number: a family is smooth, or most of it is not needed
MARGIN_SE = 1.5
STRONGEST = 1.0 / 12.0


def held_out_nats(columns: Array, r: Array, rows: Rows) -> float:
    """Gain [nats] on the folds that a linear model of the columns was not fitted to; 0 where it foretells nothing."""
    left = r - foretold(columns, r, rows)
    return float((costs(r) - costs(left)).sum())


def steady_nats(columns: Array, r: Array, rows: Rows) -> float:
    """The same without the strongest twelfth of the blocks in which the columns say anything.

    Why: a fault of a joint shows all the time. What a few jerks do may go with anything.
    """
    left = r - foretold(columns, r, rows)
    gains = np.bincount(rows.block, weights=costs(r) - costs(left))
    told = np.sort(gains[np.unique(rows.block[np.any(columns != 0.0, axis=1)])])
    return max(0.0, float(told[: len(told) - math.ceil(STRONGEST * len(told))].sum()))


def foretold(columns: Array, r: Array, rows: Rows, ridges: tuple[float, ...] = RIDGES) -> Array:
    """What a linear model of the columns says of each fold (N,) when fitted to the others; zeros where it says nothing.

    Model: min sum w (r - B x)^2 + ridge |x|^2 without each fold in turn, columns of one size; the best ridge by its
           gain, sum rho(r) - rho(r - B x), that is at least 1.5 standard errors over blocks.
    Args:  columns: (N, k), white as the residual r (N,) is. ridges: a large one foretells more, and less than is there.
    """
    size, best = np.sqrt(np.mean(columns**2, axis=0)), np.zeros(len(r))
    B = columns[:, size > 0.0] / size[size > 0.0]
    if B.shape[1] == 0 or rows.block.max(initial=0) == 0:  # one block has no others to be foretold from
        return best
    w, folds = weights(r), np.unique(rows.fold)
    own = [_normal(B, r, w, rows.fold == fold) for fold in folds]
    H, g = np.sum([part[0] for part in own], axis=0), np.sum([part[1] for part in own], axis=0)
    most = 0.0
    for ridge in ridges:
        said = np.zeros(len(r))
        for fold, (H_own, g_own) in zip(folds, own, strict=True):
            x = np.linalg.solve(H - H_own + ridge * np.eye(B.shape[1]), g - g_own)
            said[rows.fold == fold] = B[rows.fold == fold] @ x
        gains = np.bincount(rows.block, weights=costs(r) - costs(r - said))
        if gains.mean() > MARGIN_SE * gains.std(ddof=1) / np.sqrt(len(gains)) and gains.sum() > most:
            best, most = said, float(gains.sum())
    return best


def _normal(B: Array, r: Array, w: Array, chosen: NDArray[np.bool_]) -> tuple[Array, Array]:
    weighed = B[chosen].T * w[chosen]
    return weighed @ B[chosen], weighed @ r[chosen]
