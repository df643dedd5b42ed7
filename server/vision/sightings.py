"""From images to sightings: what both marker pose sources have in common."""

from collections.abc import Iterable

import cv2
import numpy as np

from machine.description import Machine, Marker
from server.vision.contracts import Array, Image
from server.vision.detection import EyeDetection, EyeDetector
from server.vision.errors import NoMarkersError
from server.vision.object_pose import ObjectName, Sighting

BLACK_MEAN_GREY = 4.0
SATURATED_FRAC = 0.5
NOTHING = EyeDetection({}, {}, frozenset(), full_search=False)


def markers_by_object(machine: Machine) -> dict[ObjectName, tuple[Marker, ...]]:
    """The machine's markers by what they sit on.

    Raises: NoMarkersError when tool or OOI has none.
    """
    found: dict[ObjectName, tuple[Marker, ...]] = {"tool": machine.markers_on("tool"), "ooi": machine.markers_on("ooi")}
    for name, markers in found.items():
        if not markers and not machine.boards_on(name):
            raise NoMarkersError(
                f"machine '{machine.name}' has no marker on the {name}; add a [[markers.marker]] or [[markers.board]]"
            )
    return found


def image_problem(name: str, image: Image) -> str:
    """Why an eye's image cannot show anything; empty when it can."""
    if image.ndim != 2 or image.dtype != np.uint8 or image.size == 0:
        return f"{name} image is {image.shape} {image.dtype}, not a grey 8-bit picture; check the camera source"
    thumb = image[:: max(1, image.shape[0] // 64), :: max(1, image.shape[1] // 64)]
    if float(thumb.mean()) < BLACK_MEAN_GREY:
        return f"{name} image is black; check lens cap, light and exposure"
    if float((thumb >= 254).mean()) > SATURATED_FRAC:
        return f"{name} image is saturated; reduce exposure or light"
    return ""


def sightings_of(markers: Iterable[Marker], left: dict[int, Array], right: dict[int, Array]) -> tuple[Sighting, ...]:
    """The markers that at least one eye sees."""
    return tuple(
        Sighting(marker, left.get(marker.marker_id), right.get(marker.marker_id))
        for marker in markers
        if marker.marker_id in left or marker.marker_id in right
    )


def detect_safely(detector: EyeDetector, image: Image) -> EyeDetection:
    """Markers in one image of any kind: what cannot be searched shows none."""
    if image.ndim != 2 or image.dtype != np.uint8 or min(image.shape, default=0) == 0:
        return NOTHING
    try:
        return detector.detect(image)
    except cv2.error:  # a shape OpenCV cannot search shows no marker
        return NOTHING
