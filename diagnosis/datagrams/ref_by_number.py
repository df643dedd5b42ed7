"""The reference that the PLC had, where it was not logged but the number of its datagram was."""

from dataclasses import replace

import numpy as np

from diagnosis.log.findings import Finding
from diagnosis.log.quality import LOG_ROWS_MIN
from diagnosis.log.tables import Tables

MATCHED_ROWS_MIN_FRAC = 0.99  # of the rows between the first and the last that have a datagram of sent.csv


def with_reference(tables: Tables) -> tuple[Tables, list[Finding]]:
    """The tables with q_ref as sent in the datagram of each row; unchanged where it was logged or none is named.

    What the PLC made of the numbers (rounding, a rate limit) is not seen then: it looks like the controller.
    """
    plc, sent = tables.plc, tables.sent
    if plc is None or sent is None or plc.ref is not None or (plc.seq < 0).all():
        return tables, []
    known = np.nonzero((sent.seq >= 0) & np.isfinite(sent.q).all(axis=1))[0]
    numbers, first = np.unique(sent.seq[known], return_index=True)
    if len(numbers) < len(known) or len(numbers) == 0:  # numbers that begin again are ambiguous
        return tables, []
    at = np.minimum(np.searchsorted(numbers, plc.seq), len(numbers) - 1)
    found = numbers[at] == plc.seq
    rows = np.nonzero(found)[0]
    if len(rows) < LOG_ROWS_MIN or len(rows) < MATCHED_ROWS_MIN_FRAC * (rows[-1] - rows[0] + 1):
        return tables, []
    ref = np.full((len(plc.t_s), sent.q.shape[1]), np.nan)
    ref[rows] = sent.q[known[first[at[rows]]]]
    text = "no q_ref: it is taken from sent.csv, by seq_received; what the PLC makes of its numbers is not seen"
    return replace(tables, plc=replace(plc, ref=ref, ref_logged=False)), [
        Finding("no_reference", "note", "plc.csv", text)
    ]
