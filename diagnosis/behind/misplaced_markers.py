"""Markers under each other's ids, and corners that begin at another one: far from how the machine file places them."""

from itertools import combinations
from typing import Literal

import numpy as np

from diagnosis.behind.points import rigid_fit, rms_m
from diagnosis.behind.views import pairs_of, triangulated
from diagnosis.log.findings import Finding
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import Tables
from machine.markers import object_corners
from machine.poses import transform_points
from machine.rotations import Array

LOOKS_MIN, LOOKS_MAX = 5, 60
MISPLACEMENT_MIN_M = 0.03  # of a print: no object bends so far
# How much nearer the corners have to lie by the correction stated: a stereo pair's depth is noisy
IMPROVEMENT_RATIO_MIN = 3.0

Layout = dict[int, Array]


def misplaced_markers(tables: Tables, nominal: Nominal) -> list[Finding]:
    """Misplaced markers, by looks at two or more markers of one object, each in both eyes."""
    return _findings_on_object(tables, nominal, "tool") + _findings_on_object(tables, nominal, "ooi")


def _findings_on_object(tables: Tables, nominal: Nominal, on: Literal["tool", "ooi"]) -> list[Finding]:
    layout = object_corners(marker for marker in nominal.markers if marker.on == on)
    looks = _triangulated_views(tables, nominal, layout)
    if len(looks) < LOOKS_MIN:
        return []
    as_written = _off_m(looks, layout)
    if as_written < MISPLACEMENT_MIN_M:
        return []
    seen = sorted({number for numbers, _ in looks for number in numbers})
    ways = [
        (_off_m(looks, {**layout, a: layout[b], b: layout[a]}), "swapped_columns", f"markers {a} and {b} are exchanged")
        for a, b in combinations(seen, 2)
    ] + [
        (
            _off_m(looks, {number: np.roll(corners, first, axis=0) for number, corners in layout.items()}),
            "corner_order",
            "corners do not begin at the marker's top left one",
        )
        for first in (1, 2, 3)
    ]
    away, code, what = min(ways)
    if IMPROVEMENT_RATIO_MIN * away > as_written:
        return []
    text = f"{what}: as written the corners on the {on} lie {1e3 * as_written:.3g} mm from where the machine file has "
    return [Finding(code, "fatal", "markers.csv", f"{text}them, the other way {1e3 * away:.3g} mm")]


def _triangulated_views(tables: Tables, nominal: Nominal, layout: Layout) -> list[tuple[list[int], Array]]:
    """Ids of an object's markers and their corners (4 k, 3) [m] in the left eye, of some looks at two or more."""
    camera = nominal.camera
    if camera is None or tables.markers is None or len(layout) < 2:
        return []
    pairs = [(numbers, left, right) for _, numbers, left, right in pairs_of(tables.markers, layout) if len(numbers) > 1]
    some = pairs[:: max(1, len(pairs) // LOOKS_MAX)]
    looks = [(numbers, triangulated(camera, left, right)) for numbers, left, right in some]
    return [look for look in looks if np.isfinite(look[1]).all()]


def _off_m(looks: list[tuple[list[int], Array]], layout: Layout) -> float:
    """How far corners lie from a rigid layout, rms of a look, the middle one of all looks."""
    off = []
    for numbers, points in looks:
        wanted = np.concatenate([layout[number] for number in numbers])
        off.append(rms_m(points - transform_points(rigid_fit(wanted, points), wanted)))
    return float(np.median(off))
