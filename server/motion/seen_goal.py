"""The goal as the last looks of a moving camera place it: each look's own goal in the base, near ones weighing more.

A look taken on the way, joined with the encoders at its exposure, gives the goal's pose in base axes, whatever happens
later: the OOI stands still. Errors of the map grow with the way that is left, so near looks weigh more.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from machine.poses import pose
from machine.rotations import rotation_from_rotvec, rotvec_from_rotation
from server.motion.contracts import Array

GOAL_BUFFER_SIZE = 12
MAP_ERROR_FRAC = 0.03  # error of the local map, share of the way that is left
GOAL_JUMP_FLOOR_M = 0.004
GOAL_JUMP_MAX_SIGMAS = 5.0


@dataclass(slots=True)
class SeenGoal:
    """Goals T_base_tcp of the last looks around a first one; forgets all but the newest `GOAL_BUFFER_SIZE`."""

    T_first: Array
    _seen: deque[tuple[Array, float]] = field(default_factory=lambda: deque(maxlen=GOAL_BUFFER_SIZE))

    def jump_and_limit(self, T_base_goal: Array, sigma_m: float, way_m: float) -> tuple[float, float]:
        """How far a look's goal is off the present one, and how far it may be [m]; beyond it must not be used."""
        apart_m = float(np.linalg.norm(T_base_goal[:3, 3] - self.pose[:3, 3]))
        return apart_m, max(GOAL_JUMP_FLOOR_M, GOAL_JUMP_MAX_SIGMAS * _sigma_with_map_error(sigma_m, way_m))

    def add(self, T_base_goal: Array, sigma_m: float, way_m: float) -> None:
        """Take in a look's goal (4, 4): its own sigma [m] and the way that was left then [m]."""
        turn = rotvec_from_rotation(T_base_goal[:3, :3] @ self.T_first[:3, :3].T)
        shift = T_base_goal[:3, 3] - self.T_first[:3, 3]
        self._seen.append((np.concatenate([turn, shift]), _sigma_with_map_error(sigma_m, way_m)))

    @property
    def pose(self) -> Array:
        """The weighted mean (4, 4)."""
        if not self._seen:
            return self.T_first
        weights = np.array([sigma**-2 for _, sigma in self._seen])
        mean = weights @ np.array([d for d, _ in self._seen]) / weights.sum()
        return pose(rotation_from_rotvec(mean[:3]) @ self.T_first[:3, :3], self.T_first[:3, 3] + mean[3:])


def _sigma_with_map_error(sigma_m: float, way_m: float) -> float:
    return float(np.hypot(sigma_m, MAP_ERROR_FRAC * way_m))
