"""Which rows of markers.csv can be used for an object: known markers, a named eye, corners, and a time that counts."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import MarkerTable

CLOCK_OFFSET_MARGIN_S = 0.6  # a stretch's ends: the clock's offset may lie this far off
CORNER_ROWS_MIN = 8


def seen_rows(nominal: Nominal, table: MarkerTable, on: Literal["tool", "ooi"]) -> NDArray[np.bool_]:
    """Rows (m,) of a marker on that object, by a known eye, with a time and at least one corner."""
    known = [marker.marker_id for marker in nominal.markers if marker.on == on]
    whole = np.asarray(np.isfinite(table.corners_px).all(axis=2), dtype=bool)
    corner = np.any(whole, axis=1)
    return np.asarray(np.isin(table.marker_ids, known) & (table.eye >= 0) & np.isfinite(table.t_s) & corner, dtype=bool)
