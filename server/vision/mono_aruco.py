"""The paper's own marker poses: left eye only, unrefined corners, first planar solution, one marker."""

from dataclasses import replace

import numpy as np

from machine.camera import undistort_to_rays
from machine.description import Machine
from machine.poses import inverse_pose
from server.vision.contracts import Array, Image, MarkerView, ObjectPose, PairObservation, PoseStatus
from server.vision.detection import DetectionSettings, EyeDetector
from server.vision.object_pose import NO_RIVAL, ObjectName, not_seen
from server.vision.planar_pose import planar_poses
from server.vision.sightings import detect_safely, image_problem, markers_by_object, sightings_of

MONO_SIGMA_PX = 0.5  # of unrefined corners


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
        best = max(sightings, key=lambda one: _area(one.left_px), default=None)
        if best is None or best.left_px is None:
            return not_seen(name, f"no marker of the {name} in the left eye")
        marker = best.marker
        solutions = planar_poses(undistort_to_rays(self._camera, best.left_px), marker.side_m)
        if not solutions:
            return not_seen(name, f"marker {marker.marker_id} of the {name} allows no planar pose")
        T_cam_object = solutions[0] @ inverse_pose(marker.T_on_marker)
        covariance = _rough_covariance(T_cam_object, marker.side_m, self._camera.fx_px)
        ids = (marker.marker_id,)
        return ObjectPose(name, PoseStatus.OK, "", T_cam_object, covariance, ids, float("nan"), NO_RIVAL)


def _area(corners: Array | None) -> float:
    if corners is None:
        return 0.0
    x, y = corners[:, 0], corners[:, 1]
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _rough_covariance(T_cam_object: Array, side_m: float, focal_px: float) -> Array:
    """Rules of thumb for a frontal marker: lateral s z/(2 f), range 0.75 s z^2/(f a), tilt 1.9 s z^2/(f a^2)."""
    z = float(T_cam_object[2, 3])
    lateral = MONO_SIGMA_PX * z / (2.0 * focal_px)
    along = 0.75 * MONO_SIGMA_PX * z * z / (focal_px * side_m)
    tilt = 1.9 * MONO_SIGMA_PX * z * z / (focal_px * side_m**2)
    roll = MONO_SIGMA_PX * z / (focal_px * side_m)
    return np.diag(np.square([tilt, tilt, roll, lateral, lateral, along]))
