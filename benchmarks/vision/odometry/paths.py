"""The ways the camera goes: a circle of 20 cm, and the paper's asymmetric zig-zag, with the sway of a long boom."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np

from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec
from server.motion.calibration_paths import paper_corners

Shape = Literal["circle", "paper"]
SHAPES: tuple[str, ...] = get_args(Shape)
RADIUS_M = 0.20
ACCELERATION_M_S2 = 0.2
REST_S = 0.4  # before and after the way
SWAY_M = 1e-3  # amplitude per axis, boom on its springs
SWAY_RAD = np.deg2rad(0.3)
SWAY_HZ = (0.7, 2.5)


def leg_offsets(shape: Shape) -> list[Array]:
    """Straight or round legs as polylines (n, 3) [m] in TCP axes (x up, y left), from the start back to the start."""
    if shape == "circle":
        angle = np.linspace(0.0, 2.0 * np.pi, 721)
        return [RADIUS_M * np.column_stack((np.cos(angle) - 1.0, np.sin(angle), np.zeros_like(angle)))]
    corners = np.vstack((np.zeros(3), paper_corners()))
    return [np.array(leg) for leg in pairwise(corners)]


@dataclass(frozen=True, slots=True)
class Leg:
    """One leg driven with a trapezoid of speed, from rest to rest."""

    t_start_s: float
    points: Array
    lengths: Array  # (n,) way to each point [m]
    speed_m_s: float

    @property
    def ramp_s(self) -> float:
        """Time to reach the speed; shorter legs never reach the set one."""
        return float(min(self.speed_m_s / ACCELERATION_M_S2, np.sqrt(self.lengths[-1] / ACCELERATION_M_S2)))

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        ramp = self.ramp_s
        return 2.0 * ramp + (self.lengths[-1] - ACCELERATION_M_S2 * ramp**2) / (ACCELERATION_M_S2 * ramp)

    def offset(self, t_s: float) -> Array:
        """Offset (3,) [m] at a time since this leg's start, held before and after."""
        ramp, total = self.ramp_s, self.duration_s
        t = float(np.clip(t_s, 0.0, total))
        if t < ramp:
            way = 0.5 * ACCELERATION_M_S2 * t**2
        elif t < total - ramp:
            way = ACCELERATION_M_S2 * ramp * (t - 0.5 * ramp)
        else:
            way = self.lengths[-1] - 0.5 * ACCELERATION_M_S2 * (total - t) ** 2
        return np.array([np.interp(way, self.lengths, self.points[:, k]) for k in range(3)])


@dataclass(frozen=True, slots=True)
class SwayingPath:
    """True tool poses over time: the legs, plus a sway that does not stop (a pose history of the renderer)."""

    T_base_start: Array
    legs: tuple[Leg, ...]
    sway_hz: Array  # (6,)
    sway_phase: Array

    @property
    def duration_s(self) -> float:
        """With the rest before and after."""
        return self.legs[-1].t_start_s + self.legs[-1].duration_s + REST_S

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp at a true time [ns]."""
        t_s = 1e-9 * t_ns
        current = max((leg for leg in self.legs if leg.t_start_s <= t_s), key=lambda leg: leg.t_start_s, default=None)
        offset = np.zeros(3) if current is None else current.offset(t_s - current.t_start_s)
        sway = np.sin(2.0 * np.pi * self.sway_hz * t_s + self.sway_phase)
        return self.T_base_start @ pose(rotation_from_rotvec(SWAY_RAD * sway[:3]), offset + SWAY_M * sway[3:])


def drawn_path(shape: Shape, T_base_start: Array, speed_m_s: float, rng: np.random.Generator) -> SwayingPath:
    """A path of this shape from a start pose, at a speed, with its own sway."""
    legs, t_s = [], REST_S
    for points in leg_offsets(shape):
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        leg = Leg(t_s, points, lengths, speed_m_s)
        legs.append(leg)
        t_s += leg.duration_s
    return SwayingPath(T_base_start, tuple(legs), rng.uniform(*SWAY_HZ, 6), rng.uniform(0.0, 2.0 * np.pi, 6))
