"""What the markers contradict: an id at two places, a marker that has moved on its board."""

from collections.abc import Sequence

import numpy as np
from numba import njit

from machine.description import StereoCamera
from server.camera.contracts import StereoFrame
from server.camera.health.findings import FaultCode, Finding, Pair
from server.vision.contracts import (
    DUPLICATE_MARKER_REASON,
    EYES_SWAPPED_REASON,
    MOVED_MARKER_REASON,
    ROWS_DIFFER_REASON,
    Array,
    Image,
    MarkerView,
    ObjectPose,
    PoseStatus,
)

RESIDUAL_MAX_PX = 0.3
LAYOUT_ERROR_MAX_M = 0.00075  # residual of a carefully measured layout, printed sides included
WHITE_MARGIN_OFFSET_FRAC = 0.06  # of a side: half a cell outside of it, where a print has its white margin
CLIPPED_GREY, CLIPPED_FRAC, CLIPPED_PLACES = 254, 0.8, 17


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
        findings = [finding for view in pair.observation.marker_views if (finding := _of_view(view)) is not None]
        findings += [
            over for view in pair.observation.marker_views if view.used for over in _over_exposed(view, pair.frame)
        ]
        for found in (pair.observation.tool, pair.observation.ooi):
            if found.status is PoseStatus.REJECTED:
                findings.append(_rejected_pose_finding(found.reason))
            elif found.T_cam_object is not None:
                findings += self._pose_residual_findings(found, pair.observation.marker_views)
        return tuple({finding.text: finding for finding in findings}.values())

    def _pose_residual_findings(self, found: ObjectPose, views: Sequence[MarkerView]) -> tuple[Finding, ...]:
        T_cam_object = found.T_cam_object
        used = [view for view in views if view.marker_id in found.marker_ids and view.used]
        alone = len(found.marker_ids) < 2
        if T_cam_object is None or (alone and not any(map(_by_both_eyes, used))):  # one marker in one eye fits itself
            return ()
        layout_px = 0.0 if alone else LAYOUT_ERROR_MAX_M * self._focal_px / max(float(T_cam_object[2, 3]), 0.05)
        limit_px = max(RESIDUAL_MAX_PX, layout_px)
        if not found.residual_rms_px > limit_px:
            return ()
        if alone:
            return (_marker_misfit_finding(found, limit_px),)
        worst = max(used, key=lambda view: view.residual_rms_px, default=None)
        which = "" if worst is None else f", most of it at marker {worst.marker_id} ({worst.residual_rms_px:.2f} px)"
        text = (
            f"the {found.object_name}'s markers contradict their layout: residual {found.residual_rms_px:.2f} px rms "
            f"(limit {limit_px:.2f} px){which}; a marker has {MOVED_MARKER_REASON}: fix it, then measure the layout "
            "again"
        )
        return (Finding(FaultCode.MARKER_MOVED, text, forbids_odometry=False),)


def _by_both_eyes(view: MarkerView) -> bool:
    """Whether both eyes saw this square; of a board's many corners another rms is usual."""
    eyes = (view.corners_left_px, view.corners_right_px)
    return all(corners is not None and len(corners) == 4 for corners in eyes)


def _over_exposed(view: MarkerView, frame: StereoFrame) -> tuple[Finding, ...]:
    """White that is cut off at the top grows over the black next to it: the marker looks smaller, with clean sides."""
    for eye, corners, image in (
        ("left", view.corners_left_px, frame.left),
        ("right", view.corners_right_px, frame.right),
    ):
        if corners is None or len(corners) != 4:
            continue
        share = _clipped_frac(image, np.ascontiguousarray(corners, dtype=np.float64))
        if share > CLIPPED_FRAC:
            text = (
                f"marker {view.marker_id}'s white is over-exposed in the {eye} eye: {100 * share:.0f} % of it along a "
                f"side is at its end (limit {100 * CLIPPED_FRAC:.0f} %); lower the exposure or shade it"
            )
            return (Finding(FaultCode.SATURATED, text, forbids_odometry=False),)
    return ()


@njit(cache=True, nogil=True)
def _clipped_frac(image: Image, corners: Array) -> float:
    """Share of the white just outside a side that has the highest grey, at the side with the most; a side that leaves
    the picture does not count.
    """
    height, width = image.shape
    most = 0.0
    for i in range(4):
        x0, y0 = corners[i, 0], corners[i, 1]
        dx, dy = corners[(i + 1) % 4, 0] - x0, corners[(i + 1) % 4, 1] - y0
        clipped = 0
        for k in range(CLIPPED_PLACES):
            t = 0.1 + 0.8 * k / (CLIPPED_PLACES - 1)
            x, y = (
                np.rint(x0 + WHITE_MARGIN_OFFSET_FRAC * dy + t * dx),
                np.rint(y0 - WHITE_MARGIN_OFFSET_FRAC * dx + t * dy),
            )
            if not (x >= 0 and y >= 0 and x < width and y < height):
                clipped = 0
                break
            if image[int(y), int(x)] >= CLIPPED_GREY:
                clipped += 1
        most = max(most, clipped / CLIPPED_PLACES)
    return most


def _marker_misfit_finding(found: ObjectPose, limit_px: float) -> Finding:
    """Both eyes see one target and no pose of its size fits both."""
    text = (
        f"the {found.object_name}'s marker fits no pose of its size: residual {found.residual_rms_px:.2f} px rms "
        f"(limit {limit_px:.2f} px); its print is of another size than the machine file's side, something lies over "
        "it, or it is over-exposed: measure its side, clean it, lower the exposure"
    )
    return Finding(FaultCode.MARKER_MOVED, text, forbids_odometry=False)


def _rejected_pose_finding(reason: str) -> Finding:
    """Corners that fit no pose: the rig, or else the layout, is not what the machine file says."""
    for words, code in ((EYES_SWAPPED_REASON, FaultCode.EYES_SWAPPED), (ROWS_DIFFER_REASON, FaultCode.ROWS_DIFFER)):
        if words in reason:
            return Finding(code, reason)
    return Finding(FaultCode.MARKER_MOVED, reason, forbids_odometry=False)


def _of_view(view: MarkerView) -> Finding | None:
    if DUPLICATE_MARKER_REASON in view.reason:
        return Finding(FaultCode.MARKER_TWICE, view.reason, forbids_odometry=False)
    if MOVED_MARKER_REASON in view.reason:
        text = f"{view.reason}: fix it, then measure the layout again"
        return Finding(FaultCode.MARKER_MOVED, text, forbids_odometry=False)
    return None
