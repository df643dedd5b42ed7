"""Whether one pair may steer the machine: seen whole, fit, and sharp enough. Anything else is a reason to stop."""

from dataclasses import dataclass

import numpy as np

from server.jobs.context import PlanContext
from server.jobs.requests import PairSeen
from server.vision.contracts import ObjectPose, PoseStatus
from server.vision.errors import NoPoseError
from server.vision.goal_error import pair_error


@dataclass(frozen=True, slots=True)
class PairGate:
    """The closed loop's own gate, with the settings' limits."""

    ctx: PlanContext

    def fault(self, seen: PairSeen) -> str:
        """Why the pair must not be acted upon; empty when it may."""
        if seen.fault:
            return seen.fault
        for found, name in ((seen.tool, "tool"), (seen.ooi, "object of interest")):
            reason = _unfit_pose_reason(found)
            if reason:
                return f"{name}: {reason}"
        if seen.q_rad is None:
            return "no encoders at the pair's exposure"
        sigma_mm, limit_mm = 1e3 * self.sigma_m(seen), self.ctx.settings.closed_loop.sigma_max_mm
        if not sigma_mm <= limit_mm:
            return f"the error of one pair is only known to {sigma_mm:.1f} mm (limit {limit_mm:g} mm); come nearer"
        return ""

    def sigma_m(self, seen: PairSeen) -> float:
        """One sigma of the worst axis of the error by this pair alone [m]; inf without poses."""
        if seen.tool is None or seen.ooi is None:
            return float("inf")
        try:
            return float(np.max(pair_error(seen.tool, seen.ooi, self.ctx.T_ooi_goal).sigma_position_m))
        except NoPoseError:
            return float("inf")


def _unfit_pose_reason(found: ObjectPose | None) -> str:
    if found is None:
        return "not looked for"
    if found.status is PoseStatus.OK and found.T_cam_object is not None:
        return ""
    return found.reason or found.status.value
