"""Hand-eye calibration of two streams with separate clocks: the offset is searched within a bound, and reported."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from server.calibration.contracts import Array, CalibrationStatus
from server.calibration.hand_eye import DEFAULT_SETTINGS, solve_poses, usable_covariances
from server.calibration.hand_eye_contracts import HandEyeEstimate, HandEyeSettings, refused
from server.calibration.hand_eye_linear import Indices, inverse_poses, motions_between, rotation_vectors
from server.calibration.trajectory_matching_refusals import require_track_shape, time_refusal, usable_poses

_PAIR_SPAN_S = 0.5  # motions compared in the offset search: long enough to stand above the noise
_SAMPLES_MIN = 12


def estimate_hand_eye(
    t_hand_s: Array,
    Ts_base_hand: Array,
    t_cam_s: Array,
    Ts_cam_target: Array,
    unknown_scale: bool = False,
    settings: HandEyeSettings = DEFAULT_SETTINGS,
    camera_covariances: Array | None = None,
) -> HandEyeEstimate:
    """Hand-eye pose X, target pose Y and clock offset from two streams with unknown offset.

    Model:   A(t + tau) X = Y B(t). Start: the tau within the bound at which the rotation angles of both streams agree
             best (they do not depend on X); then tau is refined with X and Y. Never searched beyond the bound: on
             repeated motion a far peak can be the higher one.
    Args:    t_hand_s (m,), Ts_base_hand (m, 4, 4); t_cam_s (n,), Ts_cam_target (n, 4, 4): target in the camera;
             camera_covariances (n, 6, 6) of these, as in `solve_ax_yb`.
    Returns: the estimate with `time_offset_s` and its sigma; no pose when the streams do not determine it.
    Raises:  CalibrationInputError: shapes.
    Source:  Furrer et al. 2017 (angles for the offset); Park, Martin 1994.
    """
    require_track_shape(t_hand_s, Ts_base_hand, "hand track")
    require_track_shape(t_cam_s, Ts_cam_target, "camera track")
    wrong = time_refusal(t_hand_s, "hand track") or time_refusal(t_cam_s, "camera track")
    if wrong is not None:
        return refused(wrong.status, wrong.reason)
    good_hand, good_cam = usable_poses(np.asarray(Ts_base_hand)), usable_poses(np.asarray(Ts_cam_target))
    hand = HandPoses(t_hand_s[good_hand], Ts_base_hand[good_hand], settings.gap_max_s)
    good_cam &= hand.covers(t_cam_s, settings.offset_bound_s + 0.01)
    t_cam, Ts_cam = t_cam_s[good_cam], Ts_cam_target[good_cam]
    covariances = usable_covariances(camera_covariances, good_cam)
    if len(t_cam) < _SAMPLES_MIN:
        counts = f"{len(t_cam)} camera poses lie within the hand's track, at least {_SAMPLES_MIN} are needed"
        return refused(CalibrationStatus.TOO_FEW, f"{counts}; record both streams", len(t_cam))
    start_s = _coarse_offset(hand, t_cam, Ts_cam, settings)
    track = inverse_poses(Ts_cam)
    found = solve_poses(
        lambda offset_s: hand.at(t_cam + offset_s), track, start_s, unknown_scale, True, settings, None, covariances
    )
    if found.X is not None and abs(found.time_offset_s) >= settings.offset_bound_s:
        text = f"time offset {1e3 * found.time_offset_s:.0f} ms, bound {1e3 * settings.offset_bound_s:.0f} ms"
        return refused(CalibrationStatus.POOR_FIT, f"{text}; check the clocks", found.n_used, found.axis_spread_rad)
    text = f"time offset {1e3 * found.time_offset_s:.1f} ms, sigma {1e3 * found.time_offset_sigma_s:.1f} ms"
    return found if found.X is None else replace(found, reason=text)


class HandPoses:
    """The hand's poses at any time: rotation by slerp, position linear."""

    def __init__(self, t_s: Array, Ts: Array, gap_max_s: float) -> None:
        self._t_s, self._Ts, self._gap_max_s = t_s, Ts, gap_max_s
        self._slerp = Slerp(t_s, Rotation.from_matrix(Ts[:, :3, :3])) if len(t_s) >= 2 else None

    def at(self, t_s: Array) -> Array:
        """Poses at times (n,) [s], held at the ends."""
        t = np.clip(t_s, self._t_s[0], self._t_s[-1])
        out = np.tile(np.eye(4), (len(t), 1, 1))
        if self._slerp is not None:
            out[:, :3, :3] = self._slerp(t).as_matrix()
        out[:, :3, 3] = np.column_stack([np.interp(t, self._t_s, self._Ts[:, axis, 3]) for axis in range(3)])
        return out

    def covers(self, t_s: Array, margin_s: float) -> NDArray[np.bool_]:
        """Which times lie inside, at least the margin from the ends, and in no gap."""
        if len(self._t_s) < 2:
            return np.zeros(len(t_s), dtype=bool)
        after = np.clip(np.searchsorted(self._t_s, t_s), 1, len(self._t_s) - 1)
        dense = self._t_s[after] - self._t_s[after - 1] <= self._gap_max_s
        return dense & (t_s >= self._t_s[0] + margin_s) & (t_s <= self._t_s[-1] - margin_s)


def _coarse_offset(hand: HandPoses, t_cam: Array, Ts_cam: Array, settings: HandEyeSettings) -> float:
    """Offset on a grid within the bound at which the streams' rotation angles differ least (mean of |difference|)."""
    last = np.searchsorted(t_cam, t_cam + _PAIR_SPAN_S)
    first = np.flatnonzero(last < len(t_cam))
    last = last[first]
    close = t_cam[last] - t_cam[first] < 2.0 * _PAIR_SPAN_S
    first, last = first[close], last[close]
    if len(first) < 3:
        return 0.0
    seen = _angles(Ts_cam, first, last, swapped=True)
    steps = round(settings.offset_bound_s / settings.offset_grid_s)
    grid = np.arange(-steps, steps + 1) * settings.offset_grid_s
    costs = [float(np.mean(np.abs(_angles(hand.at(t_cam + offset_s), first, last) - seen))) for offset_s in grid]
    return float(grid[int(np.argmin(costs))])


def _angles(Ts: Array, first: Indices, last: Indices, swapped: bool = False) -> Array:
    motions = motions_between(inverse_poses(Ts) if swapped else Ts, first, last)
    return np.linalg.norm(rotation_vectors(motions[:, :3, :3]), axis=1)
