"""Tool poses during an exposure: pose history, and key poses of a rolling shutter."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from machine.rotations import Array


class PoseHistory(Protocol):
    """True tool poses of the recent past."""

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp (4, 4) at one true time [ns]."""
        ...


@dataclass(frozen=True, slots=True)
class StaticPose:
    """A tool at rest: the same pose at every time."""

    T_base_tcp: Array

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp, whatever the time."""
        return self.T_base_tcp


def shutter_times_ns(t_mid_ns: int, readout_s: float, n_keys: int) -> list[int]:
    """Mid-exposure times of `n_keys` rows spread evenly from the first to the last row [ns].

    Model:   t(row) = t_mid + (row / (rows - 1) - 1/2) readout; `t_mid_ns` is the middle row's.
    """
    return [t_mid_ns + round((k / (n_keys - 1) - 0.5) * readout_s * 1e9) for k in range(n_keys)]


def key_poses(poses: PoseHistory, t_mid_ns: int, readout_s: float, n_keys: int) -> Array:
    """T_base_tcp at the key rows of one exposure, (n_keys, 4, 4); between keys the renderer interpolates linearly."""
    if readout_s == 0.0:
        return np.repeat(poses.pose_at(t_mid_ns)[None], n_keys, axis=0)
    return np.stack([poses.pose_at(t) for t in shutter_times_ns(t_mid_ns, readout_s, n_keys)])
