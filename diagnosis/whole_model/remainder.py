"""What a part's remainder goes with: the signal whose level explains most of what its best set leaves."""

import numpy as np
from scipy.stats import rankdata

from diagnosis.whole_model.solve import WholeFit
from machine.rotations import Array

SIGNAL_LEVEL_BINS = 12  # of a signal, with as many rows each
LEAD_EXPLAINED_MIN_FRAC = 0.05  # of the remainder: a signal that explains less is not a lead


def lead_of(fit: WholeFit) -> str:
    """The strongest lead in words: what moved by itself, else a signal that explains a twentieth of what is left."""
    if fit.cell.loose_target_text:
        return fit.cell.loose_target_text
    residual = fit.best_fit.linear_model.residual
    found = [
        (explained_share(own, values), name)
        for part, own in fit.cell.by_part(residual)
        for name, values in (*part.regressors, ("time since the start", part.t_s))
        if len(values) == len(own)
    ]
    share, name = max(found, default=(0.0, ""))
    return f"goes with the {name} (explains {100 * share:.0f} % of it)" if share > LEAD_EXPLAINED_MIN_FRAC else ""


def explained_share(residual: Array, values: Array) -> float:
    """Share of a residual's variance (N,) between levels of a signal (N,), less what chance gives.

    Source: adjusted R squared.
    """
    level = np.floor((rankdata(values) - 1.0) * SIGNAL_LEVEL_BINS / len(values)).astype(np.int64)
    names, of = np.unique(level, return_inverse=True)
    count = np.bincount(of)
    mean = np.bincount(of, weights=residual) / count
    whole = float(((residual - residual.mean()) ** 2).sum())
    left = float(((residual - mean[of]) ** 2).sum())
    free = len(residual) - len(names)
    return 1.0 - left / free * (len(residual) - 1.0) / whole if whole > 0.0 and free > 0 else 0.0
