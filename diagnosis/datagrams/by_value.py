"""Which datagram a log row holds, where nobody logged numbers: the one with the row's own reference."""

import numpy as np
from numpy.typing import NDArray

from machine.rotations import Array

OFF_RAD = 1e-9
LATEST_S = 0.5  # of a datagram: an older one with the same values is chance
EARLY = 2  # datagrams later than a row's time, for clocks that are a little off
TRIED_MAX = 200


def by_value(rows: tuple[Array, Array], sent: tuple[Array, Array]) -> NDArray[np.int64]:
    """Which datagram each row (m,) holds, counted from 0; -1 where none has its values, or its neighbours have, too.

    Args: rows, sent: when [s], (m,) and (k,), on one clock, and the reference (m, n) and (k, n) [rad].
    """
    (t_row, ref), (t_sent, q) = rows, sent
    found = np.full(len(t_row), -1, dtype=np.int64)
    if len(t_sent) < 2 or ref.shape[1:] != q.shape[1:]:
        return found
    alone = np.ones(len(q), dtype=bool)
    stays = _equal(q[1:], q[:-1])
    alone[1:] &= ~stays
    alone[:-1] &= ~stays
    last = np.searchsorted(t_sent, t_row, side="right") - 1
    period_s = float(np.nanmedian(np.abs(np.diff(t_sent)))) if np.isfinite(t_sent).sum() > 1 else 0.0
    tried = int(LATEST_S / period_s) if period_s * TRIED_MAX > LATEST_S else TRIED_MAX
    for back in range(-EARLY, tried + 1):
        at = last - back
        open_ = np.nonzero((found < 0) & (at >= 0) & (at < len(q)))[0]
        fits = alone[at[open_]] & _equal(ref[open_], q[at[open_]])
        found[open_[fits]] = at[open_[fits]]
    return found


def _equal(a: Array, b: Array) -> NDArray[np.bool_]:
    """Rows whose known numbers are all the same, and some are known."""
    apart = np.abs(a - b)
    return np.asarray((np.isnan(apart) | (apart < OFF_RAD)).all(axis=1) & np.isfinite(apart).any(axis=1))
