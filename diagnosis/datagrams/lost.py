"""Datagrams that never came: a number that no row has, or one that a row should have had."""

import numpy as np
from numpy.typing import NDArray

from machine.rotations import Array

#: When [s], and the number of a datagram.
Numbered = tuple[Array, NDArray[np.int64]]
Mask = NDArray[np.bool_]

TIME_TOLERANCE_S = 1e-6  # two times nearer than this are one, written twice
ROW_TO_SEND_PERIOD_RATIO_MAX = 0.7  # of a sending period: a log row that comes later may have skipped a datagram
JITTER_MISSING_FRAC_MIN = 0.25  # of datagrams just due: fewer that are missing are lost, where nothing else shows it
LOST_DATAGRAM_MAX_FRAC = 0.5  # of what was due: where more is missing, no steady delay holds
MATCHED_ROWS_MIN = 50
TOLERATED_EXCESS_RATIO = 1.5
POISSON_LIMIT_SIGMAS = 3.0
ROWS_PER_DATAGRAM_MIN = 2  # fewer do not show how late one was


def never_received(sent: Numbered, rows: Numbered) -> tuple[Mask | None, Mask | None]:
    """Datagrams (k,) whose number no row has, although rows come often enough, and those that rows can judge.

    None where a row comes less often than a datagram, or numbers are missing: then a gap in them means nothing.
    """
    (t_sent, number), (t_row, seq) = sent, rows
    if len(number) < 2 or len(seq) < 2 or (seq < 0).any() or (np.diff(number) <= 0).any():
        return None, None
    steps = np.diff(t_row)
    often = float(np.median(steps))
    if often > ROW_TO_SEND_PERIOD_RATIO_MAX * float(np.median(np.diff(t_sent))):
        return None, None
    after = np.maximum.accumulate(seq).searchsorted(number)
    inside = (after > 0) & (after < len(seq)) & (number != seq.min())
    judged = inside.copy()
    judged[inside] = steps[after[inside] - 1] < TOLERATED_EXCESS_RATIO * often
    return judged & ~np.isin(number, seq), judged


def late_enough(lost: Mask, came: Array, rows: Numbered) -> bool:
    """Whether so few are missing (k,) that they may have come late, between the same two rows as the next one.

    Args:  came: when each should have come (k,) [s]. rows: when (m,) [s], and which datagram it shows, counted from 0.
    Model: lateness in rows beyond the usual falls off by the same share q with each row, and what is as late as the
           next datagram is in no row: of n that are a row less late, n q / (1 - q).
    """
    t_row, seen = rows
    period = int((np.median(np.diff(came)) + TIME_TOLERANCE_S) // np.median(np.diff(t_row)))
    if period < ROWS_PER_DATAGRAM_MIN or not lost.any():
        return False
    shown, first = np.unique(seen, return_index=True)
    late = first - np.searchsorted(t_row, came[shown] - TIME_TOLERANCE_S)
    late = late - np.median(late)
    last, before = (int((late == rows_late).sum()) for rows_late in (period - 1, period - 2))
    expected = last**2 / max(before - last, 1)
    return int(lost.sum()) <= expected + POISSON_LIMIT_SIGMAS * float(np.sqrt(expected))


def never_came(came: Array, rows: Numbered) -> tuple[Mask | None, Mask | None]:
    """Datagrams (k,) that were due at a row and not there, and all that were due; none where they may have been late.

    Args: came: when each should have come (k,) [s]. rows: when (m,) [s], and which datagram it shows, counted from 0.
    """
    t_row, seen = rows
    due = np.searchsorted(came, t_row + 0.5 * TIME_TOLERANCE_S, side="right") - 1
    inside = (due >= 0) & (due < len(came) - 1) & (seen > 0) & (seen <= due)
    due, shown, t = due[inside], seen[inside], t_row[inside]
    if len(due) < MATCHED_ROWS_MIN:
        return None, None
    missing = shown < due
    waited = t - came[due]
    lost, judged = np.zeros(len(came), dtype=bool), np.zeros(len(came), dtype=bool)
    if np.mean(missing) > LOST_DATAGRAM_MAX_FRAC or not _by_chance(
        missing, waited > np.median(waited) + TIME_TOLERANCE_S
    ):
        return lost, judged
    judged[due] = True
    for first, last in zip(shown[missing] + 1, due[missing] + 1, strict=True):
        lost[first:last] = True
    judged |= lost
    lost[seen] = False
    return lost, judged


def lost_rather_than_late(lost: Mask, judged: Mask, late: int) -> bool:
    """Whether datagrams that no row shows (k,) were lost, where a row comes as often as a datagram.

    Args:  late: how many a row showed one later than they were due.
    Model: one that is late comes with the next and is in no row either, unless that is late, too: of n, each late with
           probability p, n p^2 are shown late. Of lost ones none is.
    """
    n = int(judged.sum())
    both_late = float(lost.sum()) ** 2 / max(n, 1)
    return late <= JITTER_MISSING_FRAC_MIN * both_late + POISSON_LIMIT_SIGMAS * float(
        np.sqrt(JITTER_MISSING_FRAC_MIN * both_late)
    )


def _by_chance(missing: Mask, long: Mask) -> bool:
    """Whether what is missing (m,) was lost rather than late.

    Model: jitter delays those that were just due, and few that were due for `long` (m,); losses make no difference.
    """
    just, waited = int(missing[~long].sum()), int(missing[long].sum())
    if just + waited == 0:
        return True
    if not long.any():
        return just < JITTER_MISSING_FRAC_MIN * len(missing)
    expected = waited * float((~long).sum()) / float(long.sum())
    return waited > 0 and just <= TOLERATED_EXCESS_RATIO * expected + POISSON_LIMIT_SIGMAS * float(np.sqrt(expected))
