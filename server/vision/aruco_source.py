"""Tool and OOI from ArUco or AprilTag markers in both eyes: one implementation of ObjectPoseSource."""

from dataclasses import dataclass, field

from machine.description import Machine, Marker
from server.vision.contracts import Image, MarkerView, ObjectPose, PairObservation
from server.vision.detection import DetectionSettings, EyeDetector
from server.vision.mono_aruco import MonoArucoPoseSource
from server.vision.object_pose import ObjectName, PoseSettings, estimate_object_pose, not_seen
from server.vision.sightings import detect_safely, image_problem, markers_by_object, sightings_of

__all__ = ["ArucoPoseSource", "ArucoSettings", "MonoArucoPoseSource"]


@dataclass(frozen=True, slots=True)
class ArucoSettings:
    """Settings of the marker pose source."""

    detection: DetectionSettings = field(default_factory=DetectionSettings)
    pose: PoseSettings = field(default_factory=PoseSettings)


class ArucoPoseSource:
    """Pairs in, poses out. Keeps the last corners of each eye to search near them next time, nothing else."""

    def __init__(self, machine: Machine, settings: ArucoSettings | None = None) -> None:
        self._camera = machine.camera
        self._markers = markers_by_object(machine)
        self._settings = settings or ArucoSettings()
        wanted = frozenset(marker.marker_id for marker in machine.markers)
        self._left, self._right = (
            EyeDetector(machine.camera, machine.dictionary, wanted, self._settings.detection) for _ in range(2)
        )

    def observe(self, left: Image, right: Image, t_exposure_ns: int) -> PairObservation:
        """Poses in one raw grey stereo pair; what the images lack is a status and a warning."""
        problems = [problem for problem in (image_problem("left", left), image_problem("right", right)) if problem]
        found = detect_safely(self._left, left), detect_safely(self._right, right)
        poses: dict[ObjectName, ObjectPose] = {}
        views: list[MarkerView] = []
        repeated = found[0].repeated_ids | found[1].repeated_ids
        for name, markers in self._markers.items():
            usable = tuple(marker for marker in markers if marker.marker_id not in repeated)
            sightings = sightings_of(usable, found[0].markers, found[1].markers)
            poses[name], object_views = estimate_object_pose(name, sightings, self._camera, self._settings.pose)
            if not sightings:
                poses[name] = not_seen(name, _why_not_seen(poses[name].reason, problems, repeated, markers))
            views.extend(object_views)
        views.extend(_repeated_views(repeated))
        warnings = (*problems, *(view.reason for view in views if not view.used))
        return PairObservation(t_exposure_ns, poses["tool"], poses["ooi"], tuple(views), tuple(dict.fromkeys(warnings)))


def _why_not_seen(reason: str, problems: list[str], repeated: frozenset[int], markers: tuple[Marker, ...]) -> str:
    twice = sorted(marker.marker_id for marker in markers if marker.marker_id in repeated)
    if twice:
        return f"marker ids {twice} are seen twice; cover or remove the copies"
    return "; ".join(problems) or reason


def _repeated_views(repeated: frozenset[int]) -> list[MarkerView]:
    return [
        MarkerView(one, None, None, float("nan"), False, f"marker id {one} is seen at two places; cover or remove one")
        for one in sorted(repeated)
    ]
