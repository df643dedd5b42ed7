"""What every look and every calibration path adds to the joint estimate, and when the old part of it must go."""

from server.calibration.contracts import CalibrationStatus, CameraTrack, EncoderTrack
from server.calibration.joint_estimate import JointEstimate, estimate_jointly
from server.calibration.joint_observations import JointTrack, LookAt, OdometryRun
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken

LOOKS_MAX = 12
RUNS_MAX = 3


def remember_look(ctx: PlanContext, taken: LookTaken) -> None:
    """A good look at rest becomes an observation."""
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None or look.tool_covariance is None or look.ooi_covariance is None:
        return
    seen = LookAt(taken.reading.q_rad, look.T_cam_tool, look.T_cam_ooi, look.tool_covariance, look.ooi_covariance)
    ctx.knowledge.looks.append(seen)
    del ctx.knowledge.looks[:-LOOKS_MAX]
    ctx.knowledge.joint = None


def remember_run(ctx: PlanContext, camera: CameraTrack, encoder: EncoderTrack) -> None:
    """A calibration path becomes an observation."""
    if encoder.qs is None:
        return
    ctx.knowledge.runs.append(OdometryRun(camera, JointTrack(encoder.t_s, encoder.qs)))
    del ctx.knowledge.runs[:-RUNS_MAX]
    ctx.knowledge.joint = None


def joint_estimate(ctx: PlanContext) -> JointEstimate | None:
    """The estimate from all that is remembered, or None before a calibration.

    Where it contradicts itself, the OOI was moved or something slipped since the older looks: they go, and it is tried
    once more with the last look alone.
    """
    known = ctx.knowledge
    if not known.runs or not known.looks:
        return None
    if known.joint is None:
        known.joint = estimate_jointly(ctx.machine, known.runs, known.looks)
        if known.joint.status is CalibrationStatus.POOR_FIT and len(known.looks) > 1:
            del known.looks[:-1]
            known.joint = estimate_jointly(ctx.machine, known.runs, known.looks)
    return known.joint
