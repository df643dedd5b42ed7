"""Tool and OOI from ArUco or AprilTag markers: by both eyes, and by the left eye alone as in the paper."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from machine.boards import board_marker_ids
from machine.camera import undistort_to_rays
from machine.description import Board, Machine, Marker
from machine.poses import inverse_pose, pose
from server.vision.ambiguity import prior_from
from server.vision.border_fit import border_covered, printed_pattern, sides_without_margin
from server.vision.charuco import board_sighting, why_no_corner
from server.vision.charuco_saddle import fit_saddles
from server.vision.contracts import (
    DUPLICATE_MARKER_REASON,
    NO_WHITE_MARGIN_REASON,
    Array,
    Image,
    MarkerView,
    ObjectPose,
    PairObservation,
    PoseStatus,
)
from server.vision.detection import DetectionSettings, EyeDetection, EyeDetector
from server.vision.edge_fit import fit_corners
from server.vision.errors import NoMarkersError
from server.vision.marker_search import wrong_cells
from server.vision.object_pose import (
    NO_RIVAL_CHI2_MARGIN,
    ObjectName,
    PoseSettings,
    estimate_object_pose,
    not_seen,
    rig_contradiction,
)
from server.vision.planar_pose import planar_poses
from server.vision.pose_problem import PointSighting, Sighting
from server.vision.pose_refinement import PointObservations, distinct_minima

BLACK_MEAN_GREY = 4.0
SATURATED_MAX_FRAC = 0.5
EMPTY_DETECTION = EyeDetection({}, {}, frozenset(), full_search=False)


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
    if float((thumb >= 254).mean()) > SATURATED_MAX_FRAC:
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
        return EMPTY_DETECTION
    try:
        return detector.detect(image)
    except cv2.error:  # a shape OpenCV cannot search shows no marker
        return EMPTY_DETECTION


def warm_up_markers() -> None:
    """Run the marker kernels on a drawn square."""
    image = np.full((64, 64), 220, np.uint8)
    image[16:48, 16:48] = 20
    square = np.array([[16.0, 16.0], [47.0, 16.0], [47.0, 47.0], [16.0, 47.0]])
    fit_corners(image, square, 6, np.zeros(4))
    wrong_cells(image, square, np.zeros((6, 6), dtype=np.bool_))
    border_covered(image, square, printed_pattern(np.eye(6, dtype=np.bool_)))
    sides_without_margin(image, square, np.eye(6, dtype=np.bool_))
    points = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    start = pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 5.0]))
    seen = PointObservations(points, 100.0 * points[:, :2], np.zeros(4), np.array([500.0, 500.0]))
    distinct_minima(start[None], seen, 0.01)


def warm_up_boards() -> None:
    """Run the chess corner kernel on a drawn corner."""
    image = np.full((64, 64), 220, np.uint8)
    image[:32, :32] = image[32:, 32:] = 20
    fit_saddles(image, np.full((1, 2), 31.5), 16.0 * np.eye(2)[None], np.ones(1, dtype=np.bool_), 0.2)


Decoded = tuple[Mapping[int, Array], Mapping[int, Array]]


class BoardFinder:
    """Knows the boards of tool and OOI; holds nothing from pair to pair."""

    def __init__(self, machine: Machine) -> None:
        self._camera = machine.camera
        self._boards: dict[ObjectName, tuple[Board, ...]] = {
            "tool": _charuco_boards(machine.boards_on("tool")),
            "ooi": _charuco_boards(machine.boards_on("ooi")),
        }
        self.marker_ids = frozenset(
            marker_id for boards in self._boards.values() for board in boards for marker_id in board_marker_ids(board)
        )
        if self.marker_ids:
            warm_up_boards()

    def decoded_markers(self, found: tuple[EyeDetection, EyeDetection]) -> Decoded:
        """The boards' own markers in each eye, wherever they were read once."""
        repeated = found[0].repeated_ids | found[1].repeated_ids
        left, right = (
            {
                marker_id: corners
                for marker_id, corners in {**eye.covered, **eye.markers}.items()
                if marker_id in self.marker_ids and marker_id not in repeated
            }
            for eye in found
        )
        return left, right

    def sightings(self, eyes: tuple[Image, Image], decoded: Decoded) -> dict[ObjectName, tuple[PointSighting, ...]]:
        """Corners of the boards of each object that at least one eye shows."""
        return {
            name: tuple(
                seen for board in boards if (seen := board_sighting(board, eyes, decoded, self._camera)) is not None
            )
            for name, boards in self._boards.items()
        }

    def why_unseen(self, name: ObjectName, decoded: Decoded) -> list[str]:
        """Why an object's boards give no corner."""
        reasons = (why_no_corner(board, {**decoded[0], **decoded[1]}) for board in self._boards[name])
        return [reason for reason in reasons if reason]


def _charuco_boards(boards: tuple[Board, ...]) -> tuple[Board, ...]:
    return tuple(board for board in boards if board.kind == "charuco")


@dataclass(frozen=True, slots=True)
class ArucoSettings:
    """Settings of the marker pose source."""

    detection: DetectionSettings = field(default_factory=DetectionSettings)
    pose_estimation: PoseSettings = field(default_factory=PoseSettings)


class ArucoPoseSource:
    """Pairs in, poses out. Keeps the last corners of each eye to search near them next time, and the last poses: they
    decide between two orientations where images cannot.
    """

    def __init__(self, machine: Machine, settings: ArucoSettings | None = None) -> None:
        self._camera = machine.camera
        self._markers = markers_by_object(machine)
        self._all_markers = machine.markers
        self._boards = BoardFinder(machine)
        self._last: dict[ObjectName, ObjectPose] = {}
        self._t_last_ns = 0
        self._settings = settings or ArucoSettings()
        warm_up_markers()
        wanted = frozenset(marker.marker_id for marker in machine.markers)
        extra = self._boards.marker_ids
        self._left, self._right = (
            EyeDetector(machine.camera, machine.dictionary, wanted, self._settings.detection, phase, extra)
            for phase in (0, self._settings.detection.full_search_every // 2)
        )

    def observe(self, left: Image, right: Image, t_exposure_ns: int) -> PairObservation:
        """Poses in one raw grey stereo pair; what the images do not show is a status and a warning."""
        problems = [problem for problem in (image_problem("left", left), image_problem("right", right)) if problem]
        found = detect_safely(self._left, left), detect_safely(self._right, right)
        age_s = (t_exposure_ns - self._t_last_ns) * 1e-9
        poses: dict[ObjectName, ObjectPose] = {}
        views: list[MarkerView] = []
        repeated = found[0].repeated_ids | found[1].repeated_ids
        decoded = self._boards.decoded_markers(found)
        boards = self._boards.sightings((left, right), decoded)
        everything = (
            *sightings_of(self._all_markers, found[0].markers, found[1].markers),
            *boards["tool"],
            *boards["ooi"],
        )
        contradiction = rig_contradiction(everything, self._camera, self._settings.pose_estimation)
        for name, markers in self._markers.items():
            usable = tuple(marker for marker in markers if marker.marker_id not in repeated)
            sightings = (*sightings_of(usable, found[0].markers, found[1].markers), *boards[name])
            last = self._last.get(name)
            prior = None if last is None else prior_from(last, age_s)
            poses[name], object_views = estimate_object_pose(
                name, sightings, self._camera, self._settings.pose_estimation, contradiction, prior
            )
            if not sightings:
                reasons = [*problems, *_why_unused(found, markers), *self._boards.why_unseen(name, decoded)]
                poses[name] = not_seen(name, "; ".join(reasons) or poses[name].reason)
            views.extend(object_views)
        self._last, self._t_last_ns = poses, t_exposure_ns
        views.extend(_unused_views(found, {view.marker_id for view in views} | self._boards.marker_ids))
        warnings = (*problems, *(view.reason for view in views if not view.used))
        unique, searched = tuple(dict.fromkeys(warnings)), found[0].full_search or found[1].full_search
        return PairObservation(t_exposure_ns, poses["tool"], poses["ooi"], tuple(views), unique, searched)


def _why_unused(found: tuple[EyeDetection, EyeDetection], markers: tuple[Marker, ...]) -> list[str]:
    """Why the markers of an object count as not seen although something of them is."""
    ids = {marker.marker_id for marker in markers}
    return [view.reason for view in _unused_views(found, set()) if view.marker_id in ids]


def _unused_views(found: tuple[EyeDetection, EyeDetection], known: set[int]) -> list[MarkerView]:
    """Markers seen but not fit for measuring: partly covered in every eye, badly printed, or seen twice."""
    left, right = found
    views = {}
    for number in sorted({*left.covered, *right.covered} - known):
        reason = f"marker {number} is partly covered or shaded; clear the view to all four of its sides"
        if number in left.no_margin | right.no_margin:
            remedy = "print it with at least one cell of white"
            reason = f"marker {number} has {NO_WHITE_MARGIN_REASON} around its black border; {remedy}"
        seen = left.covered.get(number), right.covered.get(number)
        views[number] = MarkerView(number, *seen, float("nan"), False, reason)
    for number in sorted((left.inverted_ids | right.inverted_ids) - known - views.keys()):
        reason = f"marker {number} is printed white on black; print it black on white"
        views[number] = MarkerView(number, None, None, float("nan"), False, reason)
    for number in sorted(left.repeated_ids | right.repeated_ids):
        reason = f"marker id {number} is {DUPLICATE_MARKER_REASON}; cover or remove one"
        views[number] = MarkerView(number, None, None, float("nan"), False, reason)
    return list(views.values())


MONO_CORNER_SIGMA_PX = 0.5  # of unrefined corners


class MonoArucoPoseSource:
    """OpenCV's single-shot monocular pose per object; kept to show what the paper's method sees."""

    def __init__(self, machine: Machine, settings: DetectionSettings | None = None) -> None:
        self._camera = machine.camera
        self._markers = markers_by_object(machine)
        wanted = frozenset(marker.marker_id for marker in machine.markers)
        unrefined = replace(settings or DetectionSettings(), refine=False, full_search_every=1)
        self._left = EyeDetector(machine.camera, machine.dictionary, wanted, unrefined)

    def observe(self, left: Image, right: Image, t_exposure_ns: int) -> PairObservation:
        """Poses from the left image; the right one is not looked at."""
        problem = image_problem("left", left)
        seen = detect_safely(self._left, left).markers
        tool, ooi = (self._pose(name, seen) for name in ("tool", "ooi"))
        used = {*tool.marker_ids, *ooi.marker_ids}
        views = tuple(
            MarkerView(
                marker_id,
                corners,
                None,
                float("nan"),
                marker_id in used,
                "" if marker_id in used else "one marker is enough here",
            )
            for marker_id, corners in sorted(seen.items())
        )
        return PairObservation(t_exposure_ns, tool, ooi, views, (problem,) if problem else ())

    def _pose(self, name: ObjectName, seen: dict[int, Array]) -> ObjectPose:
        """Pose by the object's largest marker in the image, first IPPE solution taken as true."""
        sightings = sightings_of(self._markers[name], seen, {})
        best = max(sightings, key=lambda one: _quadrilateral_area(one.left_px), default=None)
        if best is None or best.left_px is None:
            return not_seen(name, f"no marker of the {name} in the left eye")
        marker = best.marker
        solutions = planar_poses(undistort_to_rays(self._camera, best.left_px), marker.side_m)
        if not solutions:
            return not_seen(name, f"marker {marker.marker_id} of the {name} allows no planar pose")
        T_cam_object = solutions[0] @ inverse_pose(marker.T_on_marker)
        covariance = _rough_covariance(T_cam_object, marker.side_m, self._camera.fx_px)
        ids = (marker.marker_id,)
        return ObjectPose(name, PoseStatus.OK, "", T_cam_object, covariance, ids, float("nan"), NO_RIVAL_CHI2_MARGIN)


def _quadrilateral_area(corners: Array | None) -> float:
    if corners is None:
        return 0.0
    x, y = corners[:, 0], corners[:, 1]
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _rough_covariance(T_cam_object: Array, side_m: float, focal_px: float) -> Array:
    """Rules of thumb for a frontal marker: lateral s z/(2 f), range 0.75 s z^2/(f a), tilt 1.9 s z^2/(f a^2)."""
    z = float(T_cam_object[2, 3])
    lateral = MONO_CORNER_SIGMA_PX * z / (2.0 * focal_px)
    along = 0.75 * MONO_CORNER_SIGMA_PX * z * z / (focal_px * side_m)
    tilt = 1.9 * MONO_CORNER_SIGMA_PX * z * z / (focal_px * side_m**2)
    roll = MONO_CORNER_SIGMA_PX * z / (focal_px * side_m)
    return np.diag(np.square([tilt, tilt, roll, lateral, lateral, along]))
