"""What is believed of camera and prints, and what it costs: the settings' prior until a path has measured."""

from dataclasses import replace

import numpy as np

from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from server.calibration.contracts import Array
from server.calibration.joint_estimate import JointEstimate
from server.calibration.joint_lens import (
    FOCAL,
    N_LENS,
    LensPrior,
    common_covariance,
    layout_in_camera,
    look_sensitivity,
)
from server.calibration.lens_evidence import lens_doubts
from server.calibration.nuisances import LAYOUT, Contribution, contributions_by_group, largest_in_words, lens_groups
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.targets.taught import anchor_covariance
from server.vision.contracts import Look
from server.vision.goal_error import error_jacobian, pose_error_covariance


def lens_prior(ctx: PlanContext) -> LensPrior:
    """The settings' prior."""
    goal = ctx.settings.position
    return LensPrior(
        sigma_focal_frac=goal.sigma_focal_frac,
        sigma_print_frac=goal.sigma_print_side_frac,
        sigma_layout_m=goal.sigma_layout_mm * 1e-3,
        sigma_layout_rad=float(np.deg2rad(goal.sigma_layout_deg)),
    )


def note_lens(ctx: PlanContext, estimate: JointEstimate) -> None:
    """Keep what an estimate says of camera and prints, for the looks to come; nothing where it is refused."""
    state, covariance = estimate.state, estimate.covariance
    known = None if state is None or covariance is None else (state.lens_corrections, covariance[-N_LENS:, -N_LENS:])
    ctx.knowledge.lens_estimate = known


def focal_found(ctx: PlanContext) -> tuple[float, float] | None:
    """True focal length over the camera file's, less 1, with one sigma, by the paths so far; None before one."""
    if ctx.knowledge.lens_estimate is None:
        return None
    mean, covariance = ctx.knowledge.lens_estimate
    return float(mean[FOCAL]), float(np.sqrt(covariance[FOCAL, FOCAL]))


def refuted_inputs(ctx: PlanContext) -> str:
    """What the last estimate refutes of camera file and prints, with the remedy; empty for nothing."""
    known = ctx.knowledge.lens_estimate
    return "" if known is None else "; ".join(lens_doubts(*known, lens_prior(ctx)))


def corrected_look(ctx: PlanContext, look: Look) -> Look:
    """The look by the camera and prints as the last estimate found them; unchanged before one."""
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        return look
    T_cam_tool, T_cam_ooi = corrected_poses(ctx, look.T_cam_tool, look.T_cam_ooi)
    return replace(look, T_cam_tool=T_cam_tool, T_cam_ooi=T_cam_ooi)


def corrected_poses(ctx: PlanContext, T_cam_tool: Array, T_cam_ooi: Array) -> tuple[Array, Array]:
    """The same of two poses as measured: less what the lens unknowns did to them, first-order."""
    if ctx.method == "paper" or ctx.knowledge.lens_estimate is None:
        return T_cam_tool, T_cam_ooi
    step = look_sensitivity(ctx.machine, T_cam_tool, T_cam_ooi) @ ctx.knowledge.lens_estimate[0]
    tool, ooi = (
        pose(rotation_from_rotvec(-by[:3]) @ T[:3, :3], T[:3, 3] - by[3:])
        for T, by in ((T_cam_tool, step[:6]), (T_cam_ooi, step[6:]))
    )
    return tool, ooi


def common_of(ctx: PlanContext, T_cam_tool: Array, T_cam_ooi: Array) -> Array:
    """Covariance (12, 12) of a look from camera, prints and layout; no further pair lessens it."""
    C = common_covariance(ctx.machine, T_cam_tool, T_cam_ooi, lens_prior(ctx), _lens_covariance(ctx))
    if ctx.knowledge.target is not None:
        C[6:, 6:] += anchor_covariance(ctx.knowledge.target, T_cam_ooi)
    return C


def require_judgeable(ctx: PlanContext, taken: LookTaken) -> None:
    """Refuse to move where no look at the goal could show that it was reached. The paper's method does not ask.

    Raises: JobFailedError: 2 sigma of a look there, scatter left out, exceeds the tolerance; with the largest source.
    """
    T_cam_tool = taken.look.T_cam_tool
    if ctx.method == "paper" or T_cam_tool is None:
        return
    T_cam_goal = T_cam_tool @ inverse_pose(ctx.T_ooi_goal)  # where the OOI is seen with the tool at its goal
    found = _look_contributions(ctx, T_cam_tool, T_cam_goal)
    goal = ctx.settings.position
    variance = np.diag(pose_error_covariance(T_cam_tool, T_cam_goal, common_of(ctx, T_cam_tool, T_cam_goal)))[:3]
    sigma_mm = np.hypot(1e3 * np.sqrt(variance), goal.sigma_systematic_mm)
    axis = int(np.argmax(sigma_mm))
    if 2.0 * sigma_mm[axis] <= goal.tolerance_mm:
        return
    doubt = refuted_inputs(ctx)
    raise JobFailedError(
        f"a look at the goal would know {'xyz'[axis]} to +-{2.0 * sigma_mm[axis]:.1f} mm only (2 sigma, allowed "
        f"{goal.tolerance_mm:g}); {largest_in_words(found, axis)}{f'; {doubt}' if doubt else ''}",
        "sigma_too_large",
    )


def _lens_covariance(ctx: PlanContext) -> Array:
    """Of the lens unknowns (7, 7): the prior's until a path has measured."""
    known = ctx.knowledge.lens_estimate
    return np.diag(lens_prior(ctx).sigma ** 2) if known is None else known[1]


def _look_contributions(ctx: PlanContext, T_cam_tool: Array, T_cam_ooi: Array) -> list[Contribution]:
    """Sources of a look's error that its pairs have in common."""
    J = error_jacobian(T_cam_tool, T_cam_ooi)[:3]
    S = look_sensitivity(ctx.machine, T_cam_tool, T_cam_ooi)
    layout = J[:, 6:] @ layout_in_camera(ctx.machine, T_cam_ooi, lens_prior(ctx)) @ J[:, 6:].T
    return [*contributions_by_group(J @ S, _lens_covariance(ctx), lens_groups()), Contribution(LAYOUT, np.diag(layout))]
