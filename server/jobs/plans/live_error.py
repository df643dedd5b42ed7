"""The error in the newest pair, for display only: no motion is ever planned from it."""

from server.cell import Cell
from server.jobs.context import PlanContext
from server.jobs.plans.looking import error_in_mm
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
    return error_in_mm(ctx, pair_error(tool, ooi, ctx.T_ooi_goal), tool.T_cam_object, ooi.T_cam_object)
