"""What planning is allowed to do: margins, speeds and the switch for reference shaping."""

from dataclasses import dataclass

import numpy as np


class MotionInputError(ValueError):
    """Input that no caller may hand over: wrong shape or not finite."""


@dataclass(frozen=True, slots=True)
class PlanSettings:
    """Settings of every planned motion. SI units; the machine's own limits come from its description."""

    knot_s: float = 0.05
    limit_share: float = 0.9  # of qd, qdd and TCP speed limits: the rest is for the PLC's rounding and resampling
    reference_tcp_share: float = 1.3  # of the TCP speed limit, for a shaped reference, which leads the lagging joints
    speed_scale: float = 1.0  # 0..1, of all speeds
    turn_speed_max_rad_s: float = 0.25
    duration_min_s: float = 1.0
    ramp_s: float = 0.8  # speeding up and slowing down, shaped references only: two periods of the 2.5 Hz boom mode
    duration_max_s: float = 120.0
    wrist_pitch_index: int = 4  # theta5: the wrist is singular where it is 0
    wrist_pitch_min_rad: float = float(np.deg2rad(10.0))
    sigma_min_min: float = 0.03
    joint_margin_rad: float = float(np.deg2rad(0.5))
    jump_max_rad: float = 0.30  # between neighbouring samples of a path: more is a change of branch
    sample_m: float = 0.01
    sample_rad: float = 0.02
    shape_reference: bool = True  # off: the paper's plain quintic

    def __post_init__(self) -> None:
        """Raises: MotionInputError: a scale of speed at which nothing would ever arrive."""
        if not self.speed_scale > 0.0:
            raise MotionInputError(f"speed_scale is {self.speed_scale:g}; give one above 0, at most 1")


DEFAULT_PLAN_SETTINGS = PlanSettings()
PAPER_PLAN_SETTINGS = PlanSettings(shape_reference=False)
