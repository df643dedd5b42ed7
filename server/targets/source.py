"""The object of interest is a chosen place: markers for the tool, the tracked target for the OOI."""

from collections.abc import Sequence
from dataclasses import replace

from machine.description import StereoCamera
from server.targets.contracts import AnchoredTarget, TargetFix, TargetSettings
from server.targets.taught import TaughtObject
from server.targets.taught_tracking import TaughtTracker
from server.targets.tool_mask import ToolMask
from server.targets.tracking import TargetTracker
from server.vision.contracts import Array, Image, ObjectPose, ObjectPoseSource, PairObservation, PoseStatus
from server.vision.object_pose import NO_RIVAL_CHI2_MARGIN


class TargetPoseSource:
    """One more ObjectPoseSource: without a target it is the marker source, with one the OOI is the target."""

    def __init__(
        self,
        markers: ObjectPoseSource,
        camera: StereoCamera,
        tool_mask: ToolMask,
        settings: TargetSettings | None = None,
    ) -> None:
        self._markers, self._camera, self._mask = markers, camera, tool_mask
        self._settings = settings or TargetSettings()
        self._tracker: TargetTracker | TaughtTracker | None = None
        self.markers: PairObservation | None = None  # what they showed in the last pair, also with a target in use

    @property
    def masks_px(self) -> tuple[Sequence[Array], Sequence[Array]]:
        """Where the own tool was in the last pair, left and right."""
        return self._mask.left_polygons, self._mask.right_polygons

    def use_target(self, target: AnchoredTarget | TaughtObject | None) -> None:
        """Serve this target as the OOI from the next pair on; None: the OOI's markers again."""
        if isinstance(target, TaughtObject):
            self._tracker = TaughtTracker(target, self._camera, self._settings)
        else:
            self._tracker = None if target is None else TargetTracker(target, self._camera, self._settings)

    def observe(self, left: Image, right: Image, t_exposure_ns: int) -> PairObservation:
        """Tool by its markers, OOI by the target; what the images do not show is a status with its reason."""
        seen = self._markers.observe(left, right, t_exposure_ns)
        self.markers = seen
        self._mask.update(seen.marker_views)
        if self._tracker is None:
            return seen
        if left.shape != right.shape or left.shape != (self._camera.height_px, self._camera.width_px):
            reason = f"target: images of {left.shape[::-1]} px; the camera file says another size"
            return replace(seen, ooi=_no_pose(PoseStatus.NOT_SEEN, reason))
        return replace(seen, ooi=_pose_of(self._tracker.find_target(left, right, self.masks_px)))


def _pose_of(fix: TargetFix) -> ObjectPose:
    if not fix.ok:
        return _no_pose(PoseStatus.REJECTED if fix.surroundings_seen else PoseStatus.NOT_SEEN, fix.reason)
    return ObjectPose(
        "ooi", PoseStatus.OK, "", fix.T_cam_target, fix.covariance, (), fix.residual_px, NO_RIVAL_CHI2_MARGIN
    )


def _no_pose(status: PoseStatus, reason: str) -> ObjectPose:
    return ObjectPose("ooi", status, reason, None, None, (), float("nan"), NO_RIVAL_CHI2_MARGIN)
