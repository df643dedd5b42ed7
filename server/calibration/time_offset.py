"""The offset between the camera's and the encoders' clocks, found by sliding one track along the other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.calibration.chords import ChordPairs, chord_vectors
from server.calibration.contracts import Array
from server.calibration.rotation_fit import fit_rotation


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """Camera time + `offset_s` = encoder time. Not `observable` when the path hardly determines it: then it is 0."""

    offset_s: float
    observable: bool
    at_bound: bool
    contrast: float  # cost 0.1 s away over cost at the minimum, minus 1


def positions_at(t_s: Array, track_t_s: Array, track_points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Track positions at other times, linear in between.

    Returns: points (n, 3) [m] and a mask (n,) of the times that lie inside the track.
    """
    points = np.column_stack([np.interp(t_s, track_t_s, track_points[:, axis]) for axis in range(3)])
    return points, np.logical_and(t_s >= track_t_s[0], t_s <= track_t_s[-1])


def _residual_norms(tau_s: float, t_s: Array, vo: Array, track_t_s: Array, track: Array, pairs: ChordPairs) -> Array:
    points, inside = positions_at(t_s + tau_s, track_t_s, track)
    keep = inside[pairs.first] & inside[pairs.last]
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
) -> TimeOffset:
    """Offset that makes the chords of both tracks fit best.

    Model:   J(tau) = mean log(1 + |r(tau)|^2 / (2 sigma)^2), r the residuals of the best rotation at tau; grid, then a
             parabola through the three points about the minimum.
    Args:    t_cam_s (n,), points_vo (n, 3): camera; t_enc_s (m,), points_base (m, 3): camera by kinematics; pairs:
             chords of the camera's samples; bound_s, step_s: search range and grid [s]; contrast_min: smallest relative
             rise of J 0.1 s away.
    Returns: the offset; 0 and observable False when J is flat; at_bound True when J still falls at the end of the
             range.
    """
    grid = np.arange(-round(bound_s / step_s), round(bound_s / step_s) + 1) * step_s
    norms = [_residual_norms(tau, t_cam_s, points_vo, t_enc_s, points_base, pairs) for tau in grid]
    medians = np.array([np.median(each) for each in norms])
    if not np.isfinite(medians).any():
        return TimeOffset(0.0, observable=False, at_bound=False, contrast=0.0)
    sigma = max(float(medians.min()) / 1.5382, 1e-5)
    cost = np.array([np.mean(np.log1p(each**2 / (2.0 * sigma) ** 2)) for each in norms])
    best = int(np.argmin(cost))
    reach = max(1, round(0.1 / step_s))
    rim = (
        min(cost[max(best - reach, 0)], cost[min(best + reach, len(grid) - 1)])
        if 0 < best < len(grid) - 1
        else cost.max()
    )
    contrast = float(rim / cost[best] - 1.0)
    if contrast < contrast_min:
        return TimeOffset(0.0, observable=False, at_bound=False, contrast=contrast)
    if best in (0, len(grid) - 1):
        return TimeOffset(float(grid[best]), observable=True, at_bound=True, contrast=contrast)
    before, here, after = cost[best - 1 : best + 2]
    shift = 0.5 * (before - after) / (before - 2.0 * here + after)
    return TimeOffset(float(grid[best] + shift * step_s), observable=True, at_bound=False, contrast=contrast)
