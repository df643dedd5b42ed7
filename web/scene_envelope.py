"""Reach envelope lines: outline of the tool's reach in the arm plane, and the ends of slew."""

from itertools import pairwise

import numpy as np

from machine.chain import Chain
from machine.kinematics import tcp_poses
from machine.rotations import Array

GRID = 13
SECTORS = 36
CLEAR_M = 0.02  # above the floor


def reach_segments(chain: Chain) -> Array:
    """A circle on the floor at the furthest reach, and the outline of the reach upright, slew in the middle.

    Returns: segments (k, 2, 3) [m, base].
    """
    points = _reachable(chain)
    radius = np.hypot(points[:, 0], points[:, 1])
    rim = _arc(float(radius.max()), float(chain.q_min[0]), float(chain.q_max[0]))
    return np.concatenate([rim, _outline(radius, points[:, 2], _slew_middle(chain))])


def slew_limits(chain: Chain) -> Array:
    """Two lines on the floor from the base to the reach, at both ends of the first joint (2, 2, 3) [m, base]."""
    points = _reachable(chain)
    radius = float(np.hypot(points[:, 0], points[:, 1]).max())
    ends = [np.array([radius * np.cos(q), radius * np.sin(q), CLEAR_M]) for q in (chain.q_min[0], chain.q_max[0])]
    return np.array([[[0.0, 0.0, CLEAR_M], end] for end in ends])


def _slew_middle(chain: Chain) -> float:
    return 0.5 * float(chain.q_min[0] + chain.q_max[0])


def _reachable(chain: Chain) -> Array:
    """TCP positions (k, 3) over a grid of the second and third joint, the others in their middle."""
    q_mid = 0.5 * (chain.q_min + chain.q_max)
    lift, tilt = (np.linspace(chain.q_min[i], chain.q_max[i], GRID) for i in (1, 2))
    qs = np.tile(q_mid, (GRID * GRID, 1))
    qs[:, 1], qs[:, 2] = (values.ravel() for values in np.meshgrid(lift, tilt))
    return tcp_poses(chain, qs)[:, :3, 3]


def _arc(radius: float, start: float, end: float) -> Array:
    angles = np.linspace(start, end, SECTORS + 1)
    rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full_like(angles, CLEAR_M)])
    return np.array(list(pairwise(rim)))


def _outline(radius: Array, height: Array, azimuth: float) -> Array:
    """The outermost point of each sector about the middle of the reach, joined."""
    middle = np.array([radius.mean(), height.mean()])
    away = np.column_stack([radius, height]) - middle
    sector = ((np.arctan2(away[:, 1], away[:, 0]) + np.pi) / (2.0 * np.pi) * SECTORS).astype(int) % SECTORS
    length = np.linalg.norm(away, axis=1)
    outer = [
        int(np.flatnonzero(sector == s)[length[sector == s].argmax()]) for s in range(SECTORS) if (sector == s).any()
    ]
    rim = np.array([[radius[i] * np.cos(azimuth), radius[i] * np.sin(azimuth), max(CLEAR_M, height[i])] for i in outer])
    return np.array(list(pairwise([*rim, rim[0]])))
