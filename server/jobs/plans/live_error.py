"""The error in the newest pair, for display only: no motion is ever planned from it."""

from dataclasses import replace

from server.jobs.cell import Cell
from server.jobs.context import PlanContext
from server.jobs.plans.looking import error_in_mm
from server.jobs.plans.seeing import common_of, corrected_poses
from server.jobs.records import ErrorMm
from server.vision.contracts import PoseStatus
from server.vision.goal_error import pair_error


def live_error(cell: Cell, ctx: PlanContext) -> ErrorMm | None:
    """Error of the newest pair, None when tool or OOI is not seen well enough."""
    report = cell.vision.latest
    if report is None:
        return None
    tool, ooi = report.observation.tool, report.observation.ooi
    if tool.status is not PoseStatus.OK or ooi.status is not PoseStatus.OK:
        return None
    if tool.T_cam_object is None or ooi.T_cam_object is None:
        return None
    T_cam_tool, T_cam_ooi = corrected_poses(ctx, tool.T_cam_object, ooi.T_cam_object)
    tool, ooi = replace(tool, T_cam_object=T_cam_tool), replace(ooi, T_cam_object=T_cam_ooi)
    found = pair_error(tool, ooi, ctx.T_ooi_goal, common_of(ctx, T_cam_tool, T_cam_ooi))
    return error_in_mm(ctx, found, T_cam_tool, T_cam_ooi)
