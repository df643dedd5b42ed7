"""What every look and every calibration path adds to the joint estimate, and when the old part of it must go."""

from dataclasses import replace

import numpy as np

from server.calibration.contracts import Array, CalibrationStatus, CameraTrack, EncoderTrack
from server.calibration.joint_estimate import JointEstimate, JointPrior, estimate_jointly
from server.calibration.joint_observations import JointTrack, LookAt, OdometryRun
from server.calibration.kinematic_errors import usual_play
from server.calibration.lens_evidence import lens_evidence
from server.calibration.play import play_sides
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.seeing import lens_prior, note_lens
from server.jobs.requests import MachineReading

LOOK_OBSERVATIONS_MAX = 12
ODOMETRY_RUNS_MAX = 3


def play_width(ctx: PlanContext) -> Array:
    """About how wide the play of each joint is (n,) [rad]."""
    return usual_play(ctx.chain.n)


def side_now(ctx: PlanContext) -> Array:
    """Where each joint rested in its play by the last reading (n,), 0 where it was not known."""
    side = ctx.knowledge.backlash_sides
    return np.zeros(ctx.chain.n) if side is None else side


def side_at_goal(ctx: PlanContext) -> Array:
    """Where each joint will rest in its play after an approach from below, as every approach is (n,).

    By the same convention as `side_now`: of a joint whose play is not followed both are 0. With one side at the look
    and another one at the goal every step would be wrong by half of the play, and no further look would correct it.
    """
    return (play_width(ctx) > 0.0).astype(float)


def remember_side(ctx: PlanContext, reading: MachineReading) -> None:
    """Where the joints rest in their play, by the encoders at rest; unknown where they are not followed.

    Never from the request: a motion may be stopped on its way, the local lever moves the machine too, and a
    reference turns back by the stall of its valve, several times a play's width, where the joint behind it does not.
    """
    ctx.knowledge.backlash_sides = reading.side


def remember_look(ctx: PlanContext, taken: LookTaken) -> None:
    """A good look at rest becomes an observation."""
    look = taken.raw
    if look.T_cam_tool is None or look.T_cam_ooi is None or look.tool_covariance is None or look.ooi_covariance is None:
        return
    covariances = look.tool_covariance, look.ooi_covariance
    evidence = lens_evidence(ctx.machine, look.T_cam_tool, look.T_cam_ooi, look.corners_px, lens_prior(ctx))
    seen = LookAt(taken.reading.q_rad, look.T_cam_tool, look.T_cam_ooi, *covariances, side_now(ctx), evidence)
    ctx.knowledge.look_observations.append(seen)
    del ctx.knowledge.look_observations[:-LOOK_OBSERVATIONS_MAX]
    ctx.knowledge.joint_estimate = None


def remember_run(ctx: PlanContext, camera: CameraTrack, encoder: EncoderTrack, before: Array) -> None:
    """A calibration path becomes an observation; `before`: the sides of the joints when it began."""
    if encoder.qs is None or len(encoder.qs) == 0:
        return
    sides = play_sides(encoder.qs, play_width(ctx), before)
    ctx.knowledge.odometry_runs.append(OdometryRun(camera, JointTrack(encoder.t_s, encoder.qs, sides)))
    del ctx.knowledge.odometry_runs[:-ODOMETRY_RUNS_MAX]
    ctx.knowledge.joint_estimate = None


def joint_estimate(ctx: PlanContext) -> JointEstimate | None:
    """The estimate from all that is remembered, or None before a calibration.

    Where it contradicts itself, the OOI was moved or something slipped since the older looks: they go, and it is tried
    once more with the last look alone, then with the last path alone.
    """
    known = ctx.knowledge
    if not known.odometry_runs or not known.look_observations:
        return None
    if known.joint_estimate is None:
        known.joint_estimate = _combined_estimate(ctx)
        for older in (known.look_observations, known.odometry_runs):
            if known.joint_estimate.status is CalibrationStatus.POOR_FIT and len(older) > 1:
                del older[:-1]
                known.joint_estimate = _combined_estimate(ctx)
        note_lens(ctx, known.joint_estimate)
    return known.joint_estimate


def _combined_estimate(ctx: PlanContext) -> JointEstimate:
    """From the nominal machine and its class's prior, or from the diagnosed machine where the settings name one."""
    known, diagnosed = ctx.knowledge, ctx.compensation
    machine = ctx.machine if diagnosed is None else diagnosed.believed_machine()
    prior = JointPrior() if diagnosed is None else diagnosed.joint_prior()
    return estimate_jointly(
        machine, known.odometry_runs, known.look_observations, prior=replace(prior, lens=lens_prior(ctx))
    )
