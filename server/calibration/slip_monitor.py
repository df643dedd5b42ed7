"""The tool marker as a slip monitor: camera and tool sit on one flange, so the tool stays where it is in the camera."""

from dataclasses import dataclass

import numpy as np

from machine.poses import pose_difference
from server.calibration.checks import require_covariance, require_pose
from server.calibration.contracts import Array

CHI2_MAX = 27.86  # 6 degrees of freedom, 99.99 %: a look in ten thousand by chance


@dataclass(frozen=True, slots=True)
class SlipLimits:
    """From when a change is a slip: beyond chance *and* beyond what a tight mount can do.

    The minima are what a person has to tighten: 3 mm at the tool, 1 deg. Below them a change beyond chance still spoils
    a move (0.9 deg at 0.6 m are 9 mm): then the path is driven again. The floors are what a mean over pairs does not
    show: warm lens, light on the print.
    """

    chi2_max: float = CHI2_MAX
    shift_min_m: float = 0.003
    turn_min_rad: float = float(np.deg2rad(1.0))
    shift_floor_m: float = 0.0003
    turn_floor_rad: float = float(np.deg2rad(0.1))


@dataclass(frozen=True, slots=True)
class ToolSeen:
    """The tool marker in the camera at a good look: pose (4, 4), covariance (6, 6) as ObjectPose."""

    T_cam_tool: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class SlipVerdict:
    """How far the tool marker moved in the camera since the calibration; whether that is a slip, or beyond chance only
    (`shifted`): the calibration is of another mount then, and a new one is needed.
    """

    slipped: bool
    shifted: bool
    reason: str
    chi2: float
    shift_m: float
    turn_rad: float


def judge_slip(before: ToolSeen, now: ToolSeen, limits: SlipLimits | None = None) -> SlipVerdict:
    """Whether mount or marker slipped between two looks.

    Model:   d = (log(R_now R_before^T), t_now - t_before); chi2 = d^T (C_before + C_now + floors)^-1 d. Slipped when
             chi2 is beyond its bound and the shift or the turn beyond its physical minimum; shifted if only the first.
    """
    bounds = limits or SlipLimits()
    T0, T1 = require_pose(before.T_cam_tool, "T_cam_tool before"), require_pose(now.T_cam_tool, "T_cam_tool now")
    d = pose_difference(T0, T1)
    floors = np.repeat([bounds.turn_floor_rad**2, bounds.shift_floor_m**2], 3)
    C = require_covariance(before.covariance, 6, "covariance before")
    C = C + require_covariance(now.covariance, 6, "covariance now") + np.diag(floors)
    chi2 = float(d @ np.linalg.solve(C, d))
    shift_m, turn_rad = float(np.linalg.norm(d[3:])), float(np.linalg.norm(d[:3]))
    if chi2 <= bounds.chi2_max:
        return SlipVerdict(False, False, "", chi2, shift_m, turn_rad)
    large = shift_m > bounds.shift_min_m or turn_rad > bounds.turn_min_rad
    return SlipVerdict(large, not large, _slip_reason(large, shift_m, turn_rad, chi2, bounds), chi2, shift_m, turn_rad)


def _slip_reason(large: bool, shift_m: float, turn_rad: float, chi2: float, bounds: SlipLimits) -> str:
    found = (
        f"the tool marker moved by {1e3 * shift_m:.1f} mm and {np.rad2deg(turn_rad):.1f} deg in the camera since the "
        "calibration"
    )
    chance = f"chi2 {chi2:.0f}, limit {bounds.chi2_max:.0f}"
    if not large:
        return f"{found}: small, but significant ({chance}); calibrate"
    limits = f"limits {1e3 * bounds.shift_min_m:.0f} mm, {np.rad2deg(bounds.turn_min_rad):.0f} deg; {chance}"
    return f"mount or marker slipped: {found} ({limits}); tighten camera mount and tool marker, then calibrate"
