"""Where the own tool covers the images: it moves with the camera, so its corners would say that nothing moves."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from server.vision.contracts import Array, MarkerView

MASK_EXTENSION_PX = 3000.0  # beyond the border of any image
BOARD_CORNERS_MIN = 4  # fewer do not give a rectangle


def blown_up(corners_px: Array, scale: float) -> Array:
    """A polygon (n, 2) [px] scaled about its middle."""
    middle = corners_px.mean(axis=0)
    return middle + scale * (corners_px - middle)


def plate_and_shaft(corners_px: Array, scale: float) -> Array:
    """Polygon (4, 2) [px]: the blown-up marker, drawn out along its own down direction to beyond the image.

    The tool's marker stands upright on the tool, so its holder comes into the image from below the marker.
    """
    top_left, top_right, bottom_right, bottom_left = blown_up(corners_px, scale)
    down = bottom_left - top_left + bottom_right - top_right
    reach = MASK_EXTENSION_PX * down / np.linalg.norm(down)
    return np.array([top_left, top_right, bottom_right + reach, bottom_left + reach])


def smallest_rectangle(corners_px: Array) -> Array:
    """The smallest rectangle (4, 2) [px] around what is seen of a board (n, 2), some NaN: top left first, clockwise.

    The corners do not show a board's own top: the picture's is taken.
    """
    seen = corners_px[np.isfinite(corners_px).all(axis=1)].astype(np.float32)
    box = np.asarray(cv2.boxPoints(cv2.minAreaRect(seen)), dtype=float)
    turned = [np.roll(box, -k, axis=0) for k in range(4)]
    return max(turned, key=lambda one: float(one[3, 1] - one[0, 1] + one[2, 1] - one[1, 1]))


class ToolMask:
    """Polygons (4, 2) [px] over the tool targets' plates and holders in both eyes.

    The tool is rigid to the camera, so where it was last seen is where it still is.
    `tool_ids`: ids of markers and boards; with how much larger each is than what is seen of it, where it is a mapping.
    """

    def __init__(self, tool_ids: Sequence[int] | Mapping[int, float], scale: float) -> None:
        self._sizes = dict(tool_ids) if isinstance(tool_ids, Mapping) else dict.fromkeys(tool_ids, 1.0)
        self._scale = scale
        self._left: dict[int, Array] = {}
        self._right: dict[int, Array] = {}

    def update(self, views: Sequence[MarkerView]) -> None:
        """Take over where the tool's markers are in this pair."""
        for view in views:
            if view.marker_id not in self._sizes:
                continue
            scale = self._scale * self._sizes[view.marker_id]
            for corners, polygons in ((view.corners_left_px, self._left), (view.corners_right_px, self._right)):
                if corners is None:
                    continue
                square = np.asarray(corners, dtype=float)
                if self._sizes[view.marker_id] > 1.0:  # a board: many corners, row by row
                    if np.isfinite(square).all(axis=1).sum() < BOARD_CORNERS_MIN:
                        continue  # where it was seen better still holds
                    square = smallest_rectangle(square)
                polygons[view.marker_id] = plate_and_shaft(square, scale)

    @property
    def left_polygons(self) -> tuple[Array, ...]:
        """Polygons in the left image."""
        return tuple(self._left.values())

    @property
    def right_polygons(self) -> tuple[Array, ...]:
        """Polygons in the right image."""
        return tuple(self._right.values())
