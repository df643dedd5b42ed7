"""What the markers contradict: an id at two places, a marker that has moved on its board."""

from collections.abc import Sequence

from machine.description import StereoCamera
from server.camera.health.findings import FaultCode, Finding
from server.camera.health.pair import Pair
from server.vision.contracts import MarkerView, ObjectPose, PoseStatus

TWICE = "seen at two places"
MOVED = "moved on its board"
SWAPPED = "eye are swapped"
RESIDUAL_MAX_PX = 0.3
LAYOUT_MAX_M = 0.00075  # residual of a carefully measured layout, printed sides included
ROWS = "rows of the two eyes differ"


class MarkerMonitor:
    """Reads the verdicts of the marker pose source; one marker that lies makes the whole board doubtful.

    Model: where a marker sits off its place by e, the residuals of its object are about e f / z / 2; corners alone give
    less than 0.1 px.
    """

    def __init__(self, camera: StereoCamera | None) -> None:
        self._focal_px = 0.0 if camera is None else camera.fx_px

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Findings of this pair's observation; none before there is one."""
        if pair.observation is None:
            return ()
        findings = [finding for view in pair.observation.views if (finding := _of_view(view)) is not None]
        for found in (pair.observation.tool, pair.observation.ooi):
            if found.status is PoseStatus.REJECTED:
                findings.append(_rejected(found.reason))
            elif found.T_cam_object is not None:
                findings += self._residual(found, pair.observation.views)
        return tuple({finding.text: finding for finding in findings}.values())

    def _residual(self, found: ObjectPose, views: Sequence[MarkerView]) -> tuple[Finding, ...]:
        T_cam_object = found.T_cam_object
        if T_cam_object is None or len(found.marker_ids) < 2:  # one marker fits itself
            return ()
        limit_px = max(RESIDUAL_MAX_PX, LAYOUT_MAX_M * self._focal_px / max(float(T_cam_object[2, 3]), 0.05))
        if not found.residual_rms_px > limit_px:
            return ()
        worst = max(
            (view for view in views if view.marker_id in found.marker_ids and view.used),
            key=lambda view: view.residual_rms_px,
            default=None,
        )
        which = "" if worst is None else f", most of it at marker {worst.marker_id} ({worst.residual_rms_px:.2f} px)"
        text = (
            f"the {found.on}'s markers contradict their layout: residual {found.residual_rms_px:.2f} px rms (limit "
            f"{limit_px:.2f} px){which}; a marker has moved on its board: fix it, then measure the layout anew"
        )
        return (Finding(FaultCode.MARKER_MOVED, text, forbids_odometry=False),)


def _rejected(reason: str) -> Finding:
    """Corners that fit no pose: the rig, or else the layout, is not what the machine file says."""
    for words, code in ((SWAPPED, FaultCode.EYES_SWAPPED), (ROWS, FaultCode.ROWS_DIFFER)):
        if words in reason:
            return Finding(code, reason)
    return Finding(FaultCode.MARKER_MOVED, reason, forbids_odometry=False)


def _of_view(view: MarkerView) -> Finding | None:
    if TWICE in view.reason:
        return Finding(FaultCode.MARKER_TWICE, view.reason, forbids_odometry=False)
    if MOVED in view.reason:
        text = f"{view.reason}: fix it, then measure the layout anew"
        return Finding(FaultCode.MARKER_MOVED, text, forbids_odometry=False)
    return None
