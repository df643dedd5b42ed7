"""Chords: difference vectors along a path. Differencing whitens the drift and bounds the harm of a clock offset."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.calibration.contracts import Array


@dataclass(frozen=True, slots=True)
class ChordPairs:
    """Index pairs into a track: chord k runs from sample `first[k]` to sample `last[k]`."""

    first: NDArray[np.int64]
    last: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.first)


def arc_lengths(points: Array) -> Array:
    """Path length up to each point. Args: points (n, 3) [m]. Returns: (n,) [m], starting at 0."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(steps)))


def chord_pairs(points: Array, chord_m: float) -> ChordPairs:
    """Every sample with the first later one that lies `chord_m` further along the path.

    Args:    points: smooth path (the kinematic one), shape (n, 3) [m]; chord_m: arc length of a chord [m].
    Returns: pairs; samples at rest are kept once only (the last before motion), since they repeat the same chord.
    """
    s = arc_lengths(points)
    last = np.searchsorted(s, s + chord_m)
    first = np.arange(len(s))
    moving = np.concatenate((np.diff(s) > 0.002 * chord_m, [False]))
    keep = (last < len(s)) & moving
    return ChordPairs(first=first[keep], last=last[keep].astype(np.int64))


def chord_vectors(points: Array, pairs: ChordPairs) -> Array:
    """The vectors of the pairs. Args: points (n, 3) [m]. Returns: (k, 3) [m]."""
    return points[pairs.last] - points[pairs.first]
