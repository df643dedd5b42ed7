"""Joint ranges and the wrist's singularity along a path."""

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.kinematics import sigma_min, tcp_jacobian
from server.motion.contracts import Array, PlanStatus
from server.motion.refusal import Refusal
from server.motion.settings import PlanSettings


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
