"""The line equation again and again (section 5.2.1): eq. 16 with the currently measured position and distance."""

from dataclasses import dataclass

import numpy as np

from machine.poses import pose
from server.calibration.checks import CalibrationInputError, require_pose
from server.calibration.contracts import Array
from server.calibration.line_equation import image_distance


@dataclass(frozen=True, slots=True)
class LineServoSettings:
    """When the servo variant goes on, and when it ends."""

    tolerance_m: float = 0.005
    steps_max: int = 4
    wait_s: float = 1.0  # between two references at least: a look must come from after the last motion
    growth_max: float = 1.2  # of the distance from one step to the next; more means that the direction is wrong


@dataclass(frozen=True, slots=True)
class LineStep:
    """One decision: a reference pose to drive to, or none with the reason. `ended`: no further step will come."""

    T_base_tcp_ref: Array | None
    distance_m: float
    ended: bool
    reason: str


class LineServo:
    """Applies eq. 16 to what is measured now, along the direction found on the circle.

    Model:   p_ref = p_now + p_u d_now: eq. 16 with the circle's centre and r + d_min replaced by the present position
             and distance; p_u (15) stays. The distance has no sign, so a direction that is off by some degrees is never
             corrected: the paper found no improvement, and neither does the simulation.
    Args:    direction_base: p_u (3,), unit; settings.
    Raises:  CalibrationInputError: direction of another length than 1.
    Source:  Makinen et al. 2023, section 5.2.1 (last paragraph), eq. 16.
    """

    def __init__(self, direction_base: Array, settings: LineServoSettings | None = None) -> None:
        direction = np.asarray(direction_base, dtype=float)
        if direction.shape != (3,) or not abs(float(np.linalg.norm(direction)) - 1.0) < 1e-6:
            raise CalibrationInputError(f"direction_base must be a unit vector (3,), got {direction_base!r}")
        self._direction = direction
        self._settings = settings or LineServoSettings()
        self._now_s = -np.inf
        self._last_s = -np.inf
        self._last_m = np.inf
        self._steps = 0

    def step(self, t_s: float, T_base_tcp: Array, p_cam_tool: Array, p_cam_ooi: Array) -> LineStep:
        """The next reference from a look taken at rest at t_s [s].

        Args:    T_base_tcp: present pose (4, 4); p_cam_tool, p_cam_ooi: as seen there (3,) [m].
        Returns: the step; without a reference while it is too early, and at the end.
        Raises:  CalibrationInputError: not a pose, time running backwards.
        """
        T = require_pose(T_base_tcp, "T_base_tcp")
        if t_s < self._now_s:
            raise CalibrationInputError(f"time {t_s:.3f} s lies before the last call's {self._now_s:.3f} s")
        self._now_s = t_s
        d = image_distance(p_cam_tool, p_cam_ooi)  # eq. 13
        if t_s - self._last_s < self._settings.wait_s:
            return LineStep(None, d, False, f"{t_s - self._last_s:.1f} s since the last step; wait")
        ending = self._ending(d)
        if ending:
            return LineStep(None, d, True, ending)
        self._last_s, self._last_m, self._steps = t_s, d, self._steps + 1
        return LineStep(pose(T[:3, :3], T[:3, 3] + self._direction * d), d, False, "")  # eq. 16

    def _ending(self, d: float) -> str:
        limits = self._settings
        if not np.isfinite(d):
            return "tool or OOI not seen; look again"
        if d <= limits.tolerance_m:
            return f"inside {1e3 * limits.tolerance_m:.0f} mm after {self._steps} steps"
        if d > limits.growth_max * self._last_m:
            return f"distance grew from {1e3 * self._last_m:.0f} to {1e3 * d:.0f} mm: the direction is wrong; calibrate"
        if self._steps >= limits.steps_max:
            return f"{1e3 * d:.0f} mm left after {self._steps} steps (limit {limits.steps_max}); calibrate again"
        return ""
