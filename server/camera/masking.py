"""Where odometry must not look: what moves with the camera, so that its corners would say that nothing moves."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from machine.description import StereoCamera
from server.errors import SettingsError
from server.settings_camera import Mask
from server.vision.contracts import Array, Image, MarkerView

OUTLINE_PX = 1.5  # an outline may be so far from the mask that it follows


def blown_up(corners_px: Array, scale: float) -> Array:
    """A polygon (n, 2) [px] scaled about its middle."""
    middle = corners_px.mean(axis=0)
    return middle + scale * (corners_px - middle)


SHAFT_PX = 3000.0  # beyond the border of any image
BOARD_CORNERS_MIN = 4  # fewer do not give a rectangle


def plate_and_shaft(corners_px: Array, scale: float) -> Array:
    """Polygon (4, 2) [px]: the blown-up marker, drawn out along its own down direction to beyond the image.

    The tool's marker stands upright on the tool, so its holder comes into the image from below the marker.
    """
    top_left, top_right, bottom_right, bottom_left = blown_up(corners_px, scale)
    down = bottom_left - top_left + bottom_right - top_right
    reach = SHAFT_PX * down / np.linalg.norm(down)
    return np.array([top_left, top_right, bottom_right + reach, bottom_left + reach])


def around(corners_px: Array) -> Array:
    """The smallest rectangle (4, 2) [px] around what is seen of a board (n, 2), some NaN: top left first, clockwise.

    The corners do not show a board's own top: the picture's is taken.
    """
    seen = corners_px[np.isfinite(corners_px).all(axis=1)].astype(np.float32)
    box = np.asarray(cv2.boxPoints(cv2.minAreaRect(seen)), dtype=float)
    turned = [np.roll(box, -k, axis=0) for k in range(4)]
    return max(turned, key=lambda one: float(one[3, 1] - one[0, 1] + one[2, 1] - one[1, 1]))


def mask_polygons(mask: Mask, camera: StereoCamera, name: str) -> tuple[Array, ...]:
    """Polygons (k, 2) [px] of a mask in the settings.

    Raises: SettingsError: its picture cannot be read, or is not of the camera's size.
    """
    if not isinstance(mask, str):
        return tuple(np.array(polygon, dtype=float) for polygon in mask)
    try:
        data = Path(mask).read_bytes()
    except OSError as error:
        raise SettingsError(f"[camera] {name} = '{mask}': {error.strerror}; give a picture file or polygons") from error
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if picture is None:
        raise SettingsError(f"[camera] {name} = '{mask}' is not a picture; give a PNG, white where the machine is seen")
    found, wanted = (picture.shape[1], picture.shape[0]), (camera.width_px, camera.height_px)
    if found != wanted:
        raise SettingsError(
            f"[camera] {name} = '{mask}' is {found[0]} x {found[1]} px, an eye's picture {wanted[0]} x {wanted[1]} px; "
            "make the mask in that size"
        )
    return outlines(np.asarray(picture >= 128, np.uint8))


def outlines(mask: Image) -> tuple[Array, ...]:
    """Polygons (k, 2) [px] around what is not 0 in a mask (h, w); holes are covered too."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    simple = (np.asarray(cv2.approxPolyDP(contour, OUTLINE_PX, True), float).reshape(-1, 2) for contour in contours)
    return tuple(polygon for polygon in simple if len(polygon) >= 3)


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
                    square = around(square)
                polygons[view.marker_id] = plate_and_shaft(square, scale)

    @property
    def left(self) -> tuple[Array, ...]:
        """Polygons in the left image."""
        return tuple(self._left.values())

    @property
    def right(self) -> tuple[Array, ...]:
        """Polygons in the right image."""
        return tuple(self._right.values())
