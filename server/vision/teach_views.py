"""From stereo pairs to the views that teaching wants: clean corners, camera at rest, a direction not had before."""

from collections.abc import Sequence
from enum import Enum

import cv2
import numpy as np

from machine.description import Marker, StereoCamera
from machine.poses import inverse_pose
from server.vision.contracts import Array, Image
from server.vision.edge_fit import SideFit
from server.vision.marker_search import FoundMarker, find_markers, refined_marker, same_place
from server.vision.pose_problem import Sighting, pose_problem
from server.vision.pose_refinement import distinct_minima
from server.vision.teach_contracts import TeachSettings, TeachView

REST_MOTION_MAX_PX = 0.4  # median motion of the corners from pair to pair
REST_PAIRS_MIN = 3  # that must rest, one after the other
SAME_POSE_ANGLE_MAX_RAD = np.deg2rad(1.0)
ASSUMED_MARKER_SIDE_M = 0.1  # where no side is known: directions do not depend on it


class OfferedView(Enum):
    """What became of a pair that was offered as a view."""

    TAKEN = "taken"
    TOO_FEW_MARKERS = "too few markers"
    MOVING = "moving"
    ALIKE = "alike"  # as one that was taken already


def teach_view(
    left: Image, right: Image, dictionary: "cv2.aruco.Dictionary", ids: Sequence[int], camera: StereoCamera
) -> TeachView:
    """The wanted markers in one raw grey pair, searched in the whole pictures; covered ones are left out."""
    (found_left, twice_left), (found_right, twice_right) = (
        _in_eye(image, dictionary, frozenset(ids), camera) for image in (left, right)
    )
    return TeachView(found_left, found_right, twice_left | twice_right)


def _in_eye(
    image: Image, dictionary: "cv2.aruco.Dictionary", wanted: frozenset[int], camera: StereoCamera
) -> tuple[dict[int, Array], frozenset[int]]:
    places: dict[int, list[FoundMarker]] = {}
    for marker in find_markers(image, dictionary):
        known = places.setdefault(marker.marker_id, [])
        if marker.marker_id in wanted and not any(same_place(marker, other) for other in known):
            known.append(marker)
    twice = frozenset(marker_id for marker_id, found in places.items() if len(found) > 1)
    single = [found[0] for found in places.values() if len(found) == 1]
    fitted = [refined_marker(marker, image, dictionary, camera) for marker in single]
    return {marker.marker_id: marker.corners_px for marker in fitted if marker.side_fit is SideFit.CLEAN}, twice


def motion_px(one: TeachView, other: TeachView) -> float:
    """Median way of the corners between two pairs [px]; infinite where they share no marker."""
    ways = [
        np.linalg.norm(np.asarray(found[k]) - np.asarray(before[k]), axis=1)
        for found, before in (
            (one.left_corners_px, other.left_corners_px),
            (one.right_corners_px, other.right_corners_px),
        )
        for k in found.keys() & before.keys()
    ]
    return float(np.median(np.concatenate(ways))) if ways else float("inf")


def camera_in_markers(view: TeachView, camera: StereoCamera) -> dict[int, Array]:
    """Place of the left camera (3,) in the axes of each marker, in units of an unknown length common to that marker."""
    places = {}
    for marker_id in view.left_corners_px.keys() | view.right_corners_px.keys():
        marker = Marker(marker_id, ASSUMED_MARKER_SIDE_M, "ooi", np.eye(4))
        eye = {"left_px": view.left_corners_px.get(marker_id), "right_px": None}
        if eye["left_px"] is None:
            eye = {"left_px": None, "right_px": view.right_corners_px[marker_id]}
        problem = pose_problem([Sighting(marker, **eye)], camera)  # one eye: two would want the true side
        minima = distinct_minima(problem.starting_poses([0]), problem.observations, SAME_POSE_ANGLE_MAX_RAD)
        if minima:
            places[marker_id] = inverse_pose(minima[0].T_cam_object)[:3, 3]
    return places


class ViewKeeper:
    """Takes the pairs of a live camera and keeps those worth having. Holds the kept views and the last pairs."""

    def __init__(self, camera: StereoCamera, settings: TeachSettings, markers_min: int = 2) -> None:
        self._camera = camera
        self._settings = settings
        self._markers_min = markers_min
        self._places: list[dict[int, Array]] = []
        self._last: TeachView | None = None
        self._resting = 0
        self.views: list[TeachView] = []

    def keep_if_new(self, view: TeachView) -> OfferedView:
        """Keep the view if the camera rests and it differs from all that are kept."""
        if len(view.left_corners_px.keys() | view.right_corners_px.keys()) < self._markers_min:
            self._last, self._resting = None, 0
            return OfferedView.TOO_FEW_MARKERS
        still = self._last is not None and motion_px(view, self._last) < REST_MOTION_MAX_PX
        self._last, self._resting = view, self._resting + 1 if still else 1
        if self._resting < REST_PAIRS_MIN:
            return OfferedView.MOVING
        places = camera_in_markers(view, self._camera)
        if any(self._is_similar_view(places, other) for other in self._places):
            return OfferedView.ALIKE
        self._places.append(places)
        self.views.append(view)
        return OfferedView.TAKEN

    def _is_similar_view(self, one: dict[int, Array], other: dict[int, Array]) -> bool:
        both = one.keys() & other.keys()
        if not both:
            return False
        lengths = [(float(np.linalg.norm(one[k])), float(np.linalg.norm(other[k]))) for k in both]
        cosines = [one[k] @ other[k] / (a * b) for k, (a, b) in zip(both, lengths, strict=True)]
        angle_deg = float(np.rad2deg(np.median(np.arccos(np.clip(cosines, -1.0, 1.0)))))
        nearer = float(np.median([a / b for a, b in lengths]))
        return (
            angle_deg < 1.2 * self._settings.view_apart_deg  # so that every kept view counts in the end
            and abs(nearer - 1.0) < 1.2 * self._settings.view_apart_frac
        )
