"""Chords, difference vectors along a path: what they say about a rotation, and the clock offset at which they fit.

Differencing whitens the drift and bounds the harm of a clock offset.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.calibration.contracts import Array
from server.calibration.rotation_fit import fit_rotation


@dataclass(frozen=True, slots=True)
class ChordPairs:
    """Index pairs into a track: chord k runs from sample `start_indices[k]` to sample `end_indices[k]`."""

    start_indices: NDArray[np.int64]
    end_indices: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start_indices)


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
    return ChordPairs(start_indices=first[keep], end_indices=last[keep].astype(np.int64))


def chord_vectors(points: Array, pairs: ChordPairs) -> Array:
    """The vectors of the pairs. Args: points (n, 3) [m]. Returns: (k, 3) [m]."""
    return points[pairs.end_indices] - points[pairs.start_indices]


def rotation_information(vectors: Array, weights: Array) -> Array:
    """Information of paired vectors about a small rotation, per unit variance.

    Model:   A = sum w (|v|^2 I - v v^T): weak about the direction most vectors share.
    Args:    vectors (k, 3) [m]; weights (k,).
    Returns: (3, 3) [m^2].
    """
    squares = float(np.sum(weights * np.sum(vectors**2, axis=1)))
    return squares * np.eye(3) - (vectors * weights[:, None]).T @ vectors


def observability(information: Array) -> float:
    """Smallest eigenvalue over the largest, 0..1: 0 for a straight line, 1 for equal knowledge about all axes."""
    values = np.linalg.eigvalsh(information)
    return float(max(values[0], 0.0) / values[2]) if values[2] > 0.0 else 0.0


def positions_at(t_s: Array, track_t_s: Array, track_points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Track positions at other times, linear in between.

    Returns: points (n, 3) [m] and a mask (n,) of the times that lie inside the track.
    """
    points = np.column_stack([np.interp(t_s, track_t_s, track_points[:, axis]) for axis in range(3)])
    return points, np.logical_and(t_s >= track_t_s[0], t_s <= track_t_s[-1])


def _residual_norms(tau_s: float, t_s: Array, vo: Array, track_t_s: Array, track: Array, pairs: ChordPairs) -> Array:
    points, inside = positions_at(t_s + tau_s, track_t_s, track)
    keep = inside[pairs.start_indices] & inside[pairs.end_indices]
    if keep.sum() < 3:
        return np.full(1, np.inf)
    chords_base, chords_vo = chord_vectors(points, pairs)[keep], chord_vectors(vo, pairs)[keep]
    return np.linalg.norm(fit_rotation(chords_base, chords_vo, iterations=4).residuals, axis=1)


def find_time_offset(
    t_cam_s: Array,
    points_vo: Array,
    t_enc_s: Array,
    points_base: Array,
    pairs: ChordPairs,
    bound_s: float,
    step_s: float,
    contrast_min: float,
) -> float:
    """Offset [s], camera time + offset = encoder time, that makes the chords of both tracks fit best.

    Model:   J(tau) = mean log(1 + |r(tau)|^2 / (2 sigma)^2), r the residuals of the best rotation at tau; grid, then a
             parabola through the three points about the minimum.
    Args:    t_cam_s (n,), points_vo (n, 3): camera; t_enc_s (m,), points_base (m, 3): camera by kinematics; pairs:
             chords of the camera's samples; bound_s, step_s: search range and grid [s]; contrast_min: smallest relative
             rise of J 0.1 s away.
    Returns: the offset; 0 when J is flat; the end of the range when J still falls there.
    """
    grid = np.arange(-round(bound_s / step_s), round(bound_s / step_s) + 1) * step_s
    norms = [_residual_norms(tau, t_cam_s, points_vo, t_enc_s, points_base, pairs) for tau in grid]
    medians = np.array([np.median(each) for each in norms])
    if not np.isfinite(medians).any():
        return 0.0
    sigma = max(float(medians.min()) / 1.5382, 1e-5)
    cost = np.array([np.mean(np.log1p(each**2 / (2.0 * sigma) ** 2)) for each in norms])
    best = int(np.argmin(cost))
    reach = max(1, round(0.1 / step_s))
    inside = 0 < best < len(grid) - 1
    rim = min(cost[max(best - reach, 0)], cost[min(best + reach, len(grid) - 1)]) if inside else cost.max()
    if float(rim / cost[best] - 1.0) < contrast_min:
        return 0.0
    if not inside:
        return float(grid[best])
    before, here, after = cost[best - 1 : best + 2]
    return float(grid[best] + 0.5 * (before - after) / (before - 2.0 * here + after) * step_s)
