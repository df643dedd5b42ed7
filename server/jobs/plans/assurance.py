"""Before a move: is the error it will leave known well enough, and if not, what makes it so.

The ladder: a look over more pairs where the look is what spoils it, a further calibration path, then, while a later
move is left to correct it, the move itself as a closer look. Only what none of these can help is refused.
"""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from server.calibration.calibration_life import ValidityStatus
from server.calibration.reference import look_error_covariance
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken, PreviewedPlan
from server.jobs.plans.calibrating import calibrate
from server.jobs.plans.living import calibration_validity, require_valid
from server.jobs.plans.looking import good_look
from server.jobs.plans.moving import Sigmas, map_refused, preview
from server.jobs.plans.seeing import require_judgeable
from server.jobs.requests import Progress, Request

REPEATED_LOOK_PAIRS_FACTOR = 3  # times the usual pairs: what changes from pair to pair falls by 1.7
LOOK_VARIANCE_MIN_FRAC = 0.5  # of the predicted variance: below that more pairs do not help
CALIBRATION_PATHS_MAX = 2  # a third path brings little: what is left is in all of them
TOLERATED_PATH_ERROR_CODES = (
    "plan_",
    "calibration_failed",
)  # the path's planner or its match says no; nothing is lost by it
CLOSER_LOOK_TOLERANCE_FACTOR = 3.0  # times the tolerance: worse is not an approach but a guess


@dataclass(frozen=True, slots=True)
class AssuredPlan:
    """The look that the move starts from, its plan, and what was done to know enough."""

    start_look: LookTaken
    previewed_plan: PreviewedPlan
    n_calibration_paths: int


def assured_preview(
    ctx: PlanContext, taken: LookTaken, t_now_ns: int, moves_left: int
) -> Generator[Request, object, AssuredPlan]:
    """The plan of the next move, and its start look; the ladder above is climbed as far as needed.

    Args:    moves_left: moves that may follow this one.
    Raises:  JobFailedError: the calibration has slipped, there is no path, or 2 sigma stays beyond what may be driven.
    """
    paths = 0
    if _must_renew(ctx, taken):
        taken, paths = (yield from _another_path(ctx, taken)), paths + 1
    previewed = preview(ctx, taken, t_now_ns)
    require_judgeable(ctx, taken)
    if why := map_refused(ctx):
        yield Progress("assure", 0, 3, "", f"the learnt map is not used; the move is based on the look alone: {why}")
    if is_inside_tolerance(ctx, previewed.predicted_sigma_mm):
        return AssuredPlan(taken, previewed, paths)
    if _look_matters(ctx, taken, previewed.predicted_sigma_mm):
        text = f"{accuracy_text(ctx, previewed.predicted_sigma_mm)}: looking again over more pairs"
        yield Progress("assure", 1, 3, "", text)
        taken = yield from good_look(ctx, REPEATED_LOOK_PAIRS_FACTOR)
        previewed = preview(ctx, taken, t_now_ns)
    if (
        not is_inside_tolerance(ctx, previewed.predicted_sigma_mm)
        and len(ctx.knowledge.odometry_runs) < CALIBRATION_PATHS_MAX
    ):
        text = f"{accuracy_text(ctx, previewed.predicted_sigma_mm)}: a further calibration path"
        yield Progress("assure", 2, 3, "", text)
        taken, paths = (yield from _further_path(ctx, taken)), paths + 1
        previewed = preview(ctx, taken, t_now_ns)
    if not is_inside_tolerance(ctx, previewed.predicted_sigma_mm):
        yield from _closer_look_or_refuse(ctx, previewed, moves_left)
    return AssuredPlan(taken, previewed, paths)


def is_inside_tolerance(ctx: PlanContext, sigma_mm: Sigmas) -> bool:
    """Whether 2 sigma is inside the tolerance on every axis. The paper's method does not ask."""
    return ctx.method == "paper" or 2.0 * max(sigma_mm) <= ctx.settings.position.tolerance_mm


def accuracy_text(ctx: PlanContext, sigma_mm: Sigmas) -> str:
    """The worst axis in words: what is predicted and what is allowed."""
    worst = int(np.argmax(sigma_mm))
    limit_mm = ctx.settings.position.tolerance_mm
    return (
        f"the move would leave {'xyz'[worst]} known to +-{2.0 * sigma_mm[worst]:.1f} mm (2 sigma, allowed {limit_mm:g})"
    )


def _must_renew(ctx: PlanContext, taken: LookTaken) -> bool:
    """Whether the calibration has expired in a way that another path repairs; after a slip a person must look first."""
    found = calibration_validity(ctx, taken.reading)
    if found.status is ValidityStatus.SLIPPED:
        require_valid(found, "calibration")
    return not found.ok


def _another_path(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, LookTaken]:
    yield from calibrate(ctx, taken)
    return (yield from good_look(ctx))


def _further_path(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, LookTaken]:
    """Another path where there is room for one; what is known already stays good where there is not."""
    try:
        return (yield from _another_path(ctx, taken))
    except JobFailedError as error:
        if not error.code.startswith(TOLERATED_PATH_ERROR_CODES):
            raise
        yield Progress("assure", 2, 3, "", f"no further path: {error}")
    return (yield from good_look(ctx))


def _look_matters(ctx: PlanContext, taken: LookTaken, sigma_mm: Sigmas) -> bool:
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None or look.tool_covariance is None or look.ooi_covariance is None:
        return False
    # of the scatter alone: what all pairs have in common, more pairs do not lessen
    C = look_error_covariance(
        look.T_cam_tool, look.T_cam_ooi, ctx.T_ooi_goal, look.tool_covariance, look.ooi_covariance
    )
    return float(np.trace(C)) * 1e6 > LOOK_VARIANCE_MIN_FRAC * float(np.sum(np.square(sigma_mm)))


def _closer_look_or_refuse(
    ctx: PlanContext, previewed: PreviewedPlan, moves_left: int
) -> Generator[Request, object, None]:
    """Drive it as a closer look while it can still be corrected and cannot reach the wall; else refuse."""
    goal, sigma_mm = ctx.settings.position, previewed.predicted_sigma_mm
    spare_mm = goal.stand_off_mm - goal.wall_clearance_mm
    may = 2.0 * max(sigma_mm) <= CLOSER_LOOK_TOLERANCE_FACTOR * goal.tolerance_mm and 2.0 * sigma_mm[2] <= spare_mm
    if moves_left > 0 and may:
        text = f"{accuracy_text(ctx, sigma_mm)}: moving closer to look again, then correcting"
        yield Progress("assure", 3, 3, "", text)
        return
    why = "no move is left to correct it" if may else "that is too little for an approach"
    raise JobFailedError(
        f"{accuracy_text(ctx, sigma_mm)}, after {len(ctx.knowledge.odometry_runs)} calibration paths, and {why}; "
        f"{previewed.largest_source}; or start nearer to the target, or allow a wider tolerance",
        "sigma_too_large",
    )
