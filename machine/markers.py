"""Corners of square markers, in OpenCV's order."""

from collections.abc import Iterable

import numpy as np

from machine.description import Marker
from machine.errors import MachineError
from machine.poses import transform_points
from machine.rotations import Array

CORNER_SIGNS = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


def marker_corners(side_m: float) -> Array:
    """Corners (4, 3) [m] in the marker's frame (x right, y up, z out of the print): TL, TR, BR, BL."""
    if not side_m > 0.0:
        raise MachineError(f"marker side is {side_m} m; give a printed side above 0 m")
    return CORNER_SIGNS * (side_m / 2.0)


def object_corners(markers: Iterable[Marker]) -> dict[int, Array]:
    """Corners (4, 3) [m] by marker id, in the frame of the object the markers sit on."""
    return {marker.marker_id: transform_points(marker.T_on_marker, marker_corners(marker.side_m)) for marker in markers}
