"""What is drawn over one picture: markers, tool and goal as this very pair shows them, in px of the full left image."""

import numpy as np

from machine.camera import project
from machine.description import StereoCamera
from machine.rotations import Array
from server.api.views import View
from server.camera.contracts import FrameReport
from server.jobs.cell import Cell
from server.jobs.context import PlanContext
from server.vision.contracts import MarkerView, ObjectPose, PoseStatus

SEEN = (PoseStatus.OK, PoseStatus.ORIENTATION_AMBIGUOUS)
AXIS_M = 0.05


class MarkerOverlay(View):
    """One marker: corners, how well it fits, or why it was not used."""

    marker_id: int
    on: str
    corners_px: list[list[float]]
    residual_px: float
    used: bool
    reason: str


class CrossOverlay(View):
    """An origin and the ends of its x, y, z axes (50 mm)."""

    origin_px: list[float]
    axes_px: list[list[float]]


class FrameOverlay(View):
    """Header of one video frame. `age_ms` is the age when it was packed."""

    number: int
    age_ms: float
    exposure_mono_ms: float
    width_px: int
    height_px: int
    picture_width_px: int
    fps: float
    markers: list[MarkerOverlay]
    tool: CrossOverlay | None
    goal: CrossOverlay | None
    warnings: list[str]
    masks_px: list[list[list[float]]]  # polygons of the settings: nothing of the scene is looked for there


def overlay_of(cell: Cell, ctx: PlanContext, report: FrameReport, age_ms: float) -> FrameOverlay:
    """The header of this pair's picture."""
    camera, seen = cell.machine.camera, report.observation
    targets = (cell.machine.markers_on("tool"), cell.machine.boards_on("tool"))
    tool_ids = {marker.marker_id for marker in targets[0]} | {board.first_id for board in targets[1]}
    return FrameOverlay(
        number=report.sequence,
        age_ms=round(age_ms, 1),
        exposure_mono_ms=round(report.t_exposure_mapped_ns * 1e-6, 3),
        width_px=camera.width_px,
        height_px=camera.height_px,
        picture_width_px=report.preview_width_px,
        fps=round(report.fps, 1),
        markers=[_marker(view, tool_ids) for view in seen.views if view.corners_left_px is not None],
        tool=_cross(camera, _pose(seen.tool)),
        goal=_goal(camera, seen.ooi, ctx.T_ooi_goal),
        warnings=list(report.warnings),
        masks_px=[np.round(polygon, 1).tolist() for polygon in cell.vision.masks[0]],
    )


def _marker(view: MarkerView, tool_ids: set[int]) -> MarkerOverlay:
    corners = np.zeros((0, 2)) if view.corners_left_px is None else view.corners_left_px
    return MarkerOverlay(
        marker_id=view.marker_id,
        on="tool" if view.marker_id in tool_ids else "target",
        corners_px=np.round(corners, 1).tolist(),
        residual_px=round(float(np.nan_to_num(view.residual_rms_px)), 2),
        used=view.used,
        reason=view.reason,
    )


def _pose(found: ObjectPose) -> Array | None:
    return found.T_cam_object if found.status in SEEN else None


def _goal(camera: StereoCamera, ooi: ObjectPose, T_ooi_goal: Array) -> CrossOverlay | None:
    T_cam_ooi = _pose(ooi)
    return None if T_cam_ooi is None else _cross(camera, T_cam_ooi @ T_ooi_goal)


def _cross(camera: StereoCamera, T_cam_object: Array | None) -> CrossOverlay | None:
    """Projection of an object's origin and axes; None behind the camera."""
    if T_cam_object is None:
        return None
    ends_cam = T_cam_object[:3, 3] + AXIS_M * np.vstack([np.zeros(3), T_cam_object[:3, :3].T])
    if ends_cam[:, 2].min() <= 0.01:
        return None
    points = np.round(project(camera, ends_cam), 1).tolist()
    return CrossOverlay(origin_px=points[0], axes_px=points[1:])
