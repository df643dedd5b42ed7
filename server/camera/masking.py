"""Where odometry must not look: the tool moves with the camera, so its corners would say that nothing moves."""

from collections.abc import Sequence

import numpy as np

from server.vision.contracts import Array, MarkerView


def blown_up(corners_px: Array, scale: float) -> Array:
    """A polygon (n, 2) [px] scaled about its middle."""
    middle = corners_px.mean(axis=0)
    return middle + scale * (corners_px - middle)


SHAFT_PX = 3000.0  # beyond the border of any image


def plate_and_shaft(corners_px: Array, scale: float) -> Array:
    """Polygon (4, 2) [px]: the blown-up marker, drawn out along its own down direction to beyond the image.

    The tool's marker stands upright on the tool, so its holder comes into the image from below the marker.
    """
    top_left, top_right, bottom_right, bottom_left = blown_up(corners_px, scale)
    down = bottom_left - top_left + bottom_right - top_right
    reach = SHAFT_PX * down / np.linalg.norm(down)
    return np.array([top_left, top_right, bottom_right + reach, bottom_left + reach])


class ToolMask:
    """Polygons (4, 2) [px] over the tool markers' plates and holders in both eyes.

    The tool is rigid to the camera, so where it was last seen is where it still is.
    """

    def __init__(self, tool_ids: Sequence[int], scale: float) -> None:
        self._ids = frozenset(tool_ids)
        self._scale = scale
        self._left: dict[int, Array] = {}
        self._right: dict[int, Array] = {}

    def update(self, views: Sequence[MarkerView]) -> None:
        """Take over where the tool's markers are in this pair."""
        for view in views:
            if view.marker_id not in self._ids:
                continue
            for corners, polygons in ((view.corners_left_px, self._left), (view.corners_right_px, self._right)):
                if corners is not None:
                    polygons[view.marker_id] = plate_and_shaft(np.asarray(corners, float), self._scale)

    @property
    def left(self) -> tuple[Array, ...]:
        """Polygons in the left image."""
        return tuple(self._left.values())

    @property
    def right(self) -> tuple[Array, ...]:
        """Polygons in the right image."""
        return tuple(self._right.values())
