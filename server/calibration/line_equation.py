"""The paper's line equation (eq. 9-16): a circle, the nearest point on it, a line through both; and its servo."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.poses import pose
from server.calibration.checks import CalibrationInputError, require_pose
from server.calibration.contracts import Array, CalibrationStatus

Mask = NDArray[np.bool_]

METHOD_NAME = "line_equation"
CIRCLE_RADIUS_M = 0.2
CIRCLE_POINTS = 18
_POINTS_MIN = 4
_AWAY_FROM_CENTRE = 0.5  # of the radius: the nearest point must lie on the circle, or eq. 15 has no direction
_FLAT_M = 0.01  # distances that differ by less than this around the circle have no minimum


@dataclass(frozen=True, slots=True)
class LineReference:
    """Where the line equation puts the tool.

    `T_base_tcp_ref` (4, 4), `direction_base` p_u (3,), `distance_min_m`, `nearest_index` are None,
    NaN or -1 unless status is OK. `residuals_m` (n,): measured distance minus the distance to the found reference; it
    shows a wrong direction that the method itself cannot see.
    """

    status: CalibrationStatus
    reason: str
    T_base_tcp_ref: Array | None
    direction_base: Array | None
    distance_min_m: float
    nearest_index: int
    residuals_m: Array

    @property
    def residual_rms_m(self) -> float:
        """Root mean square of the residuals that exist [m]; NaN when there are none."""
        known = self.residuals_m[np.isfinite(self.residuals_m)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def circle_points(
    T_base_tcp: Array, radius_m: float = CIRCLE_RADIUS_M, n_points: int = CIRCLE_POINTS, start_rad: float = 0.0
) -> Array:
    """The circular path's points in base: centre, once around, centre.

    Model:   p(phi) = p_init + r cos(phi) n + r sin(phi) s (10-12), phi from 0 to 2 pi, both ends driven; n, s, p from
             the present pose (9).
    Args:    T_base_tcp: present pose, after the orientation step (4, 4); radius_m: r; n_points: with the two centres;
             start_rad: where the circle begins (the paper: 0).
    Returns: (n_points, 3) [m].
    Source:  Makinen et al. 2023, eq. 9-12, section 5.2.1 (18 points, r = 0.2 m).
    """
    T = require_pose(T_base_tcp, "T_base_tcp")
    if not radius_m > 0.0 or n_points < _POINTS_MIN + 1:
        raise CalibrationInputError(f"circle of radius {radius_m} m with {n_points} points; give r > 0 and at least 5")
    n, s, p_init = T[:3, 0], T[:3, 1], T[:3, 3]  # eq. 9
    phi = start_rad + np.linspace(0.0, 2.0 * np.pi, n_points - 2)
    rim = p_init + radius_m * (np.cos(phi)[:, None] * n + np.sin(phi)[:, None] * s)  # eq. 10-12
    return np.vstack((p_init, rim, p_init))


def image_distance(p_cam_tool: Array, p_cam_ooi: Array) -> float:
    """Distance of tool and OOI across the camera's axis [m] (eq. 13); the depth is not looked at."""
    x = float(p_cam_ooi[0] - p_cam_tool[0])
    y = float(p_cam_ooi[1] - p_cam_tool[1])
    return float(np.sqrt(x**2 + y**2))  # eq. 13


def line_reference(
    T_base_tcp_init: Array, points_base: Array, distances_m: Array, radius_m: float = CIRCLE_RADIUS_M
) -> LineReference:
    """Reference pose of the TCP by the minimum distance seen on the circle: orientation held, depth untouched.

    Model:   d_min = min d (13); x_init, x_eps: poses of centre and minimum (14); p_u = (p_eps - p_init) / |.| (15);
             p_ref = p_init + p_u (r + d_min) (16).
    Note:    eq. 16 holds only for an OOI outside of the circle: inside, the nearest point is the same but the way is r
             - d_min. The distance measured at the centre decides; without one it is assumed outside.
    Args:    T_base_tcp_init: the circle's centre (4, 4); points_base: TCP where each distance was measured (n, 3) [m];
             distances_m: eq. 13 at each (n,) [m], NaN where nothing was seen; radius_m: r.
    Returns: the reference; OK, or TOO_FEW, DEGENERATE with the reason and no pose.
    Source:  Makinen et al. 2023, eq. 13-16.
    """
    T_init = require_pose(T_base_tcp_init, "T_base_tcp_init")
    points, d = _require_distances(points_base, distances_m)
    on_rim = np.linalg.norm(points - T_init[:3, 3], axis=1) > _AWAY_FROM_CENTRE * radius_m
    seen = np.isfinite(d)
    refusal = _circle_refusal(d, on_rim & seen, ~on_rim & seen, radius_m)
    if refusal is not None:
        return LineReference(*refusal, None, None, float("nan"), -1, np.full(len(d), np.nan))
    nearest = int(np.flatnonzero(on_rim & seen)[np.argmin(d[on_rim & seen])])
    d_min = float(d[nearest])  # eq. 13, minimum
    p_init, p_eps = T_init[:3, 3], points[nearest]  # eq. 14
    p_u = (p_eps - p_init) / np.linalg.norm(p_eps - p_init)  # eq. 15
    p_ref = p_init + p_u * (radius_m + d_min)  # eq. 16
    residuals = d - np.linalg.norm(_perpendicular_component(points - p_ref, T_init[:3, 2]), axis=1)
    return LineReference(CalibrationStatus.OK, "", pose(T_init[:3, :3], p_ref), p_u, d_min, nearest, residuals)


def _require_distances(points_base: Array, distances_m: Array) -> tuple[Array, Array]:
    points, d = np.asarray(points_base, dtype=float), np.asarray(distances_m, dtype=float)
    if d.ndim != 1 or points.shape != (len(d), 3) or not np.isfinite(points).all():
        raise CalibrationInputError(f"points {points.shape} must be finite (n, 3), distances {d.shape} (n,)")
    if (d[np.isfinite(d)] < 0.0).any():
        raise CalibrationInputError(f"distance {np.nanmin(d):.3f} m is negative; give eq. 13")
    return points, d


def _perpendicular_component(vectors: Array, axis: Array) -> Array:
    """The part of vectors (n, 3) across an axis (3,): what the plane of motion contains."""
    return vectors - np.outer(vectors @ axis, axis)


def _circle_refusal(d: Array, rim: Mask, centre: Mask, radius_m: float) -> tuple[CalibrationStatus, str] | None:
    """Why there is no line: too few points, no minimum, or an OOI inside of the circle."""
    if rim.sum() < _POINTS_MIN:
        text = f"OOI and tool seen at {rim.sum()} points of the circle, at least {_POINTS_MIN} needed"
        return CalibrationStatus.TOO_FEW, f"{text}; keep both in view all around"
    spread = float(np.ptp(d[rim]))
    if spread < _FLAT_M:
        text = f"distances around the circle differ by {1e3 * spread:.0f} mm only (limit {1e3 * _FLAT_M:.0f} mm)"
        return CalibrationStatus.DEGENERATE, f"{text}: there is no nearest point; the OOI is already in the middle"
    if centre.any() and float(np.median(d[centre])) < radius_m:
        text = f"OOI lies {1e3 * np.median(d[centre]):.0f} mm from the middle, inside of the circle"
        limit = f"of {1e3 * radius_m:.0f} mm"
        return CalibrationStatus.DEGENERATE, f"{text} {limit}: eq. 16 would pass it; take a smaller circle"
    return None


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

    def next_reference(self, t_s: float, T_base_tcp: Array, p_cam_tool: Array, p_cam_ooi: Array) -> LineStep:
        """The next reference from a look taken at rest at t_s [s].

        Args:    T_base_tcp: present pose (4, 4); p_cam_tool, p_cam_ooi: as seen there (3,) [m].
        Returns: the step; without a reference while it is too early, and at the end.
        """
        T = require_pose(T_base_tcp, "T_base_tcp")
        if t_s < self._now_s:
            raise CalibrationInputError(f"time {t_s:.3f} s lies before the last call's {self._now_s:.3f} s")
        self._now_s = t_s
        d = image_distance(p_cam_tool, p_cam_ooi)  # eq. 13
        if t_s - self._last_s < self._settings.wait_s:
            return LineStep(None, d, False, f"{t_s - self._last_s:.1f} s since the last step; wait")
        ending = self._stop_reason(d)
        if ending:
            return LineStep(None, d, True, ending)
        self._last_s, self._last_m, self._steps = t_s, d, self._steps + 1
        return LineStep(pose(T[:3, :3], T[:3, 3] + self._direction * d), d, False, "")  # eq. 16

    def _stop_reason(self, d: float) -> str:
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
