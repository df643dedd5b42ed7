"""Geometry of the six actuators: travel y(q) and lever r(q) = dy/dq as tables on a uniform grid of the joint angle."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from machine.rotations import Array

N_LEVER_TABLE_POINTS = 361


@dataclass(frozen=True, slots=True)
class TriangleCylinder:
    """Cylinder between two pins, `foot_m` and `head_m` from the joint axis, `angle_rad` between them at q = 0."""

    foot_m: float
    head_m: float
    angle_rad: float


@dataclass(frozen=True, slots=True)
class FourBarCylinder:
    """Cylinder that turns a rocker; a coupler hands the motion to a lug on the driven boom.

    Axes: origin on the joint axis, x forward along the carrying boom, y up; the driven boom points at the joint angle.
    """

    pivot_m: tuple[float, float]  # of the rocker, on the carrying boom
    rocker_m: float
    coupler_m: float
    lug_m: float  # joint axis to the lug on the driven boom
    lug_angle_rad: float  # of the lug against the driven boom
    foot_m: tuple[float, float]  # cylinder foot on the carrying boom


# Lift: foot on the pillar, head below the boom, as on cranes of this class; lever 0.26-0.32 m for lift 0..60 deg,
# stroke used 0.52 of 0.545 m. Tilt: a four-bar found by a search for an even lever (0.19-0.24 m over -125..-20 deg).
LIFT_GEOMETRY = TriangleCylinder(foot_m=1.05, head_m=0.32, angle_rad=np.deg2rad(50.0))
TILT_GEOMETRY = FourBarCylinder(
    pivot_m=(-0.101, 0.118), rocker_m=0.407, coupler_m=0.284, lug_m=0.205, lug_angle_rad=0.02, foot_m=(-1.392, 0.029)
)


def triangle_length(geometry: TriangleCylinder, q: Array) -> Array:
    """Pin-to-pin length [m] at joint angles q [rad].

    Model:   y^2 = L1^2 + L2^2 - 2 L1 L2 cos(q + offset).
    """
    a, b = geometry.foot_m, geometry.head_m
    return np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(q + geometry.angle_rad))


def four_bar_length(geometry: FourBarCylinder, q: Array) -> Array:
    """Pin-to-pin length [m] at joint angles q [rad], by closing the loop rocker - coupler - lug.

    Raises:  ValueError: the linkage cannot close at one of the angles.
    """
    pivot = np.array(geometry.pivot_m)
    turned = q + geometry.lug_angle_rad
    across = geometry.lug_m * np.stack([np.cos(turned), np.sin(turned)], axis=1) - pivot
    distance = np.linalg.norm(across, axis=1)
    along = (geometry.rocker_m**2 - geometry.coupler_m**2 + distance**2) / (2.0 * distance)
    square = geometry.rocker_m**2 - along**2
    if np.any(square <= 0.0):
        raise ValueError(f"four-bar cannot close at {np.rad2deg(q[np.argmin(square)]):.1f} deg; change its bars")
    unit = across / distance[:, None]
    normal = np.stack([unit[:, 1], -unit[:, 0]], axis=1)
    tip = pivot + along[:, None] * unit + np.sqrt(square)[:, None] * normal
    return np.linalg.norm(tip - np.array(geometry.foot_m), axis=1)


def lever_table(geometry: TriangleCylinder | FourBarCylinder | None, low: float, high: float) -> tuple[Array, Array]:
    """Travel from the retracted end and lever over a uniform grid of joint angles.

    Args:    geometry: None for a rotary actuator (y = q - low, lever 1). low, high: first and last angle [rad].
    Returns: y (n,) [m or rad], lever dy/dq (n,) [m/rad or 1], n = N_LEVER_TABLE_POINTS.
    """
    q = np.linspace(low, high, N_LEVER_TABLE_POINTS)
    if geometry is None:
        return q - low, np.ones(N_LEVER_TABLE_POINTS)

    def length(angles: Array) -> Array:
        if isinstance(geometry, TriangleCylinder):
            return triangle_length(geometry, angles)
        return four_bar_length(geometry, angles)

    step = 1e-5
    lever = (length(q + step) - length(q - step)) / (2.0 * step)
    y = length(q)
    return y - y.min(), lever


@njit(cache=True, error_model="numpy")
def interpolate_table(table: Array, q0: float, step: float, q: float) -> float:
    """Linear interpolation in one table; the end values beyond its ends."""
    x = (q - q0) / step
    last = table.shape[0] - 1
    if x <= 0.0:
        return float(table[0])
    if x >= last:
        return float(table[last])
    i = int(x)
    return float(table[i] + (x - i) * (table[i + 1] - table[i]))
