"""Tool and OOI from ArUco or AprilTag markers in both eyes: one implementation of ObjectPoseSource."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from machine.boards import board_marker_ids
from machine.description import Board, Machine, Marker
from server.vision.ambiguity_time import prior_from
from server.vision.charuco import board_sighting, why_no_corner
from server.vision.contracts import NO_WHITE_MARGIN, Array, Image, MarkerView, ObjectPose, PairObservation
from server.vision.detection import DetectionSettings, EyeDetection, EyeDetector
from server.vision.mono_aruco import MonoArucoPoseSource
from server.vision.object_pose import (
    ObjectName,
    PointSighting,
    PoseSettings,
    estimate_object_pose,
    not_seen,
    rig_contradiction,
)
from server.vision.sightings import detect_safely, image_problem, markers_by_object, sightings_of
from server.vision.warm_up import warm_up_boards, warm_up_markers

__all__ = ["ArucoPoseSource", "ArucoSettings", "MonoArucoPoseSource"]


# The ChArUco boards of a machine in one pair: their corners as sightings, or why there are none.

Decoded = tuple[Mapping[int, Array], Mapping[int, Array]]


class BoardFinder:
    """Knows the boards of tool and OOI; holds nothing from pair to pair."""

    def __init__(self, machine: Machine) -> None:
        self._camera = machine.camera
        self._boards: dict[ObjectName, tuple[Board, ...]] = {
            "tool": _charuco(machine.boards_on("tool")),
            "ooi": _charuco(machine.boards_on("ooi")),
        }
        self.marker_ids = frozenset(
            marker_id for boards in self._boards.values() for board in boards for marker_id in board_marker_ids(board)
        )
        if self.marker_ids:
            warm_up_boards()

    def decoded(self, found: tuple[EyeDetection, EyeDetection]) -> Decoded:
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


def _charuco(boards: tuple[Board, ...]) -> tuple[Board, ...]:
    return tuple(board for board in boards if board.kind == "charuco")


@dataclass(frozen=True, slots=True)
class ArucoSettings:
    """Settings of the marker pose source."""

    detection: DetectionSettings = field(default_factory=DetectionSettings)
    pose: PoseSettings = field(default_factory=PoseSettings)


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
        decoded = self._boards.decoded(found)
        boards = self._boards.sightings((left, right), decoded)
        everything = (
            *sightings_of(self._all_markers, found[0].markers, found[1].markers),
            *boards["tool"],
            *boards["ooi"],
        )
        contradiction = rig_contradiction(everything, self._camera, self._settings.pose)
        for name, markers in self._markers.items():
            usable = tuple(marker for marker in markers if marker.marker_id not in repeated)
            sightings = (*sightings_of(usable, found[0].markers, found[1].markers), *boards[name])
            last = self._last.get(name)
            prior = None if last is None else prior_from(last, age_s)
            poses[name], object_views = estimate_object_pose(
                name, sightings, self._camera, self._settings.pose, contradiction, prior
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
            reason = f"marker {number} has {NO_WHITE_MARGIN} around its black border; {remedy}"
        seen = left.covered.get(number), right.covered.get(number)
        views[number] = MarkerView(number, *seen, float("nan"), False, reason)
    for number in sorted((left.inverted | right.inverted) - known - views.keys()):
        reason = f"marker {number} is printed white on black; print it black on white"
        views[number] = MarkerView(number, None, None, float("nan"), False, reason)
    for number in sorted(left.repeated_ids | right.repeated_ids):
        reason = f"marker id {number} is visible at two places; cover or remove one"
        views[number] = MarkerView(number, None, None, float("nan"), False, reason)
    return list(views.values())
