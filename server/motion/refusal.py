"""Why a path may not be driven: a status and a text with subject, value, limit, unit and remedy."""

from dataclasses import dataclass

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.kinematics import sigma_min, tcp_jacobian
from server.motion.contracts import Array, PathPlan, PlanStatus
from server.motion.settings import MotionInputError, PlanSettings


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


# Joint ranges and the wrist's singularity along a path.


def range_refusal(machine: Machine, qs: Array, margin_rad: float) -> Refusal | None:
    """The first joint that leaves its range less a margin; inside the margin a path may only lead back.

    Args: qs: (m, joints) [rad], the first row is where the machine stands.
    """
    for joint, values in zip(machine.joints, qs.T, strict=True):
        start = float(values[0])
        lower = max(joint.q_min_rad, min(joint.q_min_rad + margin_rad, start)) - 1e-9
        upper = min(joint.q_max_rad, max(joint.q_max_rad - margin_rad, start)) + 1e-9
        low, high = float(values.min()), float(values.max())
        if low < lower or high > upper:
            value, limit = (low, lower) if low < lower else (high, upper)
            text = (
                f"joint '{joint.name}' would reach {np.rad2deg(value):.1f} deg, limit {np.rad2deg(limit):.1f} deg; "
                "move the base posture so that this joint stays inside its range"
            )
            return Refusal(PlanStatus.JOINT_LIMIT, text)
    return None


def singular_refusal(machine: Machine, chain: Chain, qs: Array, settings: PlanSettings) -> tuple[float, Refusal | None]:
    """Smallest sigma-min of the Jacobian along the path, and the refusal near a singularity.

    Args: qs: (m, joints) [rad].
    """
    smallest = min(sigma_min(tcp_jacobian(chain, q)) for q in qs)
    if chain.n == 6:
        pitch = float(np.abs(qs[:, settings.wrist_pitch_index]).min())
        crosses = np.ptp(np.sign(qs[:, settings.wrist_pitch_index])) > 0.0
        if pitch < settings.wrist_pitch_min_rad or crosses:
            name = machine.joints[settings.wrist_pitch_index].name
            nearest = 0.0 if crosses else np.rad2deg(pitch)
            text = (
                f"joint '{name}' comes to {nearest:.1f} deg, wrist singularity at 0 deg, limit "
                f"{np.rad2deg(settings.wrist_pitch_min_rad):.1f} deg; bend the wrist more by another boom posture"
            )
            return smallest, Refusal(PlanStatus.SINGULAR, text)
    if smallest < settings.sigma_min_min:
        text = (
            f"the arm is nearly singular: smallest singular value {smallest:.3f}, limit {settings.sigma_min_min:.3f}; "
            "choose a posture with the boom less stretched"
        )
        return smallest, Refusal(PlanStatus.SINGULAR, text)
    return smallest, None
