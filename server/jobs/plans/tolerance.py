"""Whether the tool is at its goal: the error of a look against the tolerance, with two sigma to spare."""

from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.records import ErrorMm

TOLERANCE_MARGIN_SIGMAS = 2.0


def is_look_inside_tolerance(ctx: PlanContext, taken: LookTaken) -> bool:
    """Whether a look shows the tool inside the tolerance of the settings, by the rule of the method in use."""
    goal, error = ctx.settings.position, error_of(taken)
    if ctx.method == "paper":
        return inside_as_paper(error, goal.tolerance_mm)
    return is_within_tolerance(error, goal.tolerance_mm, goal.tolerance_deg)


def is_within_tolerance(error: ErrorMm, tolerance_mm: float, tolerance_deg: float) -> bool:
    """Whether every axis and the rotation are inside the tolerance with two sigma to spare."""
    axes = ((error.x_mm, error.sigma_x_mm), (error.y_mm, error.sigma_y_mm), (error.z_mm, error.sigma_z_mm))
    position = all(abs(value) + TOLERANCE_MARGIN_SIGMAS * sigma <= tolerance_mm for value, sigma in axes)
    return position and error.rotation_deg + TOLERANCE_MARGIN_SIGMAS * error.sigma_rotation_deg <= tolerance_deg


def inside_as_paper(error: ErrorMm, tolerance_mm: float) -> bool:
    """The paper's criterion: x and y in camera axes; depth and rotation are not judged."""
    return abs(error.camera_x_mm) <= tolerance_mm and abs(error.camera_y_mm) <= tolerance_mm


def error_of(taken: LookTaken) -> ErrorMm:
    """The error of a look that has one.

    Raises: JobFailedError: the look was rejected.
    """
    if taken.error is None:
        raise JobFailedError(f"look failed: {taken.record.reason}", "look_rejected")
    return taken.error
