"""Why a path may not be driven: a status and a text with subject, value, limit, unit and remedy."""

from dataclasses import dataclass

import numpy as np

from server.motion.contracts import Array, PathPlan, PlanStatus


class MotionInputError(ValueError):
    """Input that no caller may hand over: wrong shape or not finite."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """A path that is not to be driven."""

    status: PlanStatus
    reason: str


def refused_plan(refusal: Refusal, q_start: Array, Ts_base_tcp: Array | None = None) -> PathPlan:
    """The plan that carries a refusal: no trajectory, nothing moves. `Ts_base_tcp` (m, 4, 4) shows what was tried."""
    Ts = np.zeros((0, 4, 4)) if Ts_base_tcp is None else Ts_base_tcp
    return PathPlan(
        status=refusal.status,
        reason=refusal.reason,
        trajectory=None,
        Ts_base_tcp=Ts,
        q_end=np.array(q_start, dtype=float),
        length_m=0.0,
        duration_s=0.0,
        tcp_speed_max_m_s=0.0,
        clearance_m=float("nan"),
        sigma_min=float("nan"),
        joint_travel_rad=np.zeros(len(q_start)),
    )


def require_joints(q: Array, n: int, subject: str) -> Array:
    """Joint vector (n,) as float array. Raises: MotionInputError on shape or values that are not finite."""
    values = np.array(q, dtype=float)
    if values.shape != (n,) or not np.isfinite(values).all():
        raise MotionInputError(f"{subject} must be {n} finite joint angles [rad], got {values}")
    return values


def require_goal(T: Array, subject: str) -> Array:
    """Pose (4, 4) as float array. Raises: MotionInputError unless finite and a pose to 1e-6."""
    pose = np.array(T, dtype=float)
    good = pose.shape == (4, 4) and bool(np.isfinite(pose).all())
    if not good or np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-6 or np.linalg.det(pose[:3, :3]) < 0.0:
        raise MotionInputError(f"{subject} must be a finite (4, 4) pose with an orthonormal rotation")
    return pose
