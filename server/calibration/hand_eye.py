"""Hand-eye calibration A X = Y B over poses or two streams, with covariance, status and reason."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from server.calibration.checks import CalibrationInputError, require_covariance, require_track_shape
from server.calibration.contracts import Array, CalibrationStatus
from server.calibration.hand_eye_fit import (
    HandEyeUnknowns,
    HandTrack,
    Indices,
    PoseModel,
    RefinedHandEye,
    WeightedModel,
    inverse_poses,
    motions_between,
    refine_hand_eye,
    rotation_vectors,
    start_ax_yb,
    whiteners_of,
)
from server.calibration.trajectory_matching_refusals import time_refusal, usable_poses


@dataclass(frozen=True, slots=True)
class HandEyeSettings:
    """How the fit is made and what it refuses."""

    poses_min: int = 12  # fewer can be fitted exactly two by two, and say too small a covariance
    axis_spread_min_rad: float = float(np.deg2rad(2.0))  # rms rotation about the second strongest axis
    student_t_dof: float = 5.0  # of Student's t, the residuals' distribution: heavy tails, outliers fade
    iterations_max: int = 60
    n_random_starts: int = 200  # random starts from three poses each
    residual_relative_max: float = 0.25  # median residual over the size of the motion, rotation and translation
    # medians; a target's pose is known to about 1 deg and 10 mm, encoders and clock add as much
    residual_rotation_max_rad: float = float(np.deg2rad(3.0))
    residual_translation_max_m: float = 0.03
    sigma_rotation_max_rad: float = float(np.deg2rad(5.0))
    sigma_translation_max_m: float = 0.1
    offset_bound_s: float = 0.25
    offset_grid_s: float = 0.01
    gap_max_s: float = 0.2  # hand poses further apart are not interpolated


@dataclass(frozen=True, slots=True)
class HandEyeEstimate:
    """A X = Y B solved: X (hand from camera), Y (base from target), None unless status is OK.

    `covariance` (12, 12): of X and Y, each rotation vector [rad] (left perturbation) then translation [m].
    `time_offset_s`: add to the camera's time to get the hand's. `axis_spread_rad`: see the settings.
    """

    status: CalibrationStatus
    reason: str
    T_hand_cam: Array | None
    T_base_target: Array | None
    covariance: Array | None
    residual_median_deg: float
    residual_median_mm: float
    n_used: int
    axis_spread_rad: float
    time_offset_s: float = 0.0
    time_offset_sigma_s: float = 0.0


def refused_hand_eye(status: CalibrationStatus, reason: str, n: int = 0, spread: float = 0.0) -> HandEyeEstimate:
    """An estimate without a pose."""
    nan = float("nan")
    return HandEyeEstimate(status, reason, None, None, None, nan, nan, n, spread)


DEFAULT_HAND_EYE_SETTINGS = HandEyeSettings()
#: What makes residuals that no camera and no encoder have.
POSE_CONVENTION_HINT = " (order of Euler angles or quaternion, or a pose the wrong way round?)"


def solve_ax_yb(
    As: Array, Bs: Array, settings: HandEyeSettings = DEFAULT_HAND_EYE_SETTINGS, camera_covariances: Array | None = None
) -> HandEyeEstimate:
    """X and Y of A X = Y B from pairs of poses.

    Model:   best of Park-Martin on all and on random triples, then robust refinement of B^-1 = X^-1 A^-1 Y; once more
             weighted, where the images' covariances are known.
    Args:    As: base from hand, Bs: target from camera (n, 4, 4) [m]; camera_covariances (n, 6, 6): of the target in
             the camera, as `ObjectPose.covariance`: far and frontal poses count for less.
    Returns: the estimate; no X when the poses do not determine it.
    Source:  Park, Martin 1994; Zhuang, Roth, Sudhakar 1994 (A X = Y B).
    """
    As, Bs, good = _usable_pose_pairs(As, Bs)
    covariances = _usable_covariances(camera_covariances, good)
    return _solve_poses(lambda offset_s: As, Bs, 0.0, False, settings, covariances)


def _usable_covariances(camera_covariances: Array | None, good: NDArray[np.bool_]) -> Array | None:
    """Covariances (n, 6, 6) of the good poses; raises CalibrationInputError: not one of each of all poses."""
    if camera_covariances is None:
        return None
    given = np.asarray(camera_covariances, dtype=float)
    if given.shape != (len(good), 6, 6):
        raise CalibrationInputError(f"camera_covariances {given.shape} must be ({len(good)}, 6, 6)")
    return np.array([require_covariance(C, 6, "camera_covariances") for C in given[good]]).reshape(-1, 6, 6)


def _solve_poses(
    hand: HandTrack,
    Bs: Array,
    offset_start_s: float,
    free_offset: bool,
    settings: HandEyeSettings,
    camera_covariances: Array | None = None,
) -> HandEyeEstimate:
    """A X = Y B with the hand as a function of the clock offset; `free_offset`: the offset is refined along."""
    As = hand(offset_start_s)
    spread = min(_axis_spread(Ts) for Ts in (As, Bs)) if len(As) else 0.0
    refusal = _input_refusal(len(As), settings.poses_min, spread, settings)
    if refusal is not None:
        return refusal
    X, Y = start_ax_yb(As, Bs, np.random.default_rng(0), settings.n_random_starts)
    model = PoseModel(hand, inverse_poses(Bs), free_offset)
    found = refine_hand_eye(
        model, HandEyeUnknowns(X, Y, offset_start_s), settings.student_t_dof, settings.iterations_max
    )
    if camera_covariances is not None:
        weighted = WeightedModel(model, whiteners_of(camera_covariances, found.residuals, found.weights))
        again = refine_hand_eye(weighted, found.unknowns, settings.student_t_dof, settings.iterations_max)
        found = replace(again, residuals=model.evaluate(again.unknowns)[0])
    centred = Bs[:, :3, 3] - np.median(Bs[:, :3, 3], axis=0)
    turns = rotation_vectors(motions_between(Bs, *_far_pairs(len(Bs)))[:, :3, :3])
    return _judge_estimate(found, (_median_norm(turns), _median_norm(centred)), spread, settings, free_offset)


def _axis_spread(Ts: Array) -> float:
    """Rms rotation about the second strongest axis of the motions between poses (n, 4, 4) [rad]: 0 when all axes are
    parallel."""
    if len(Ts) < 3:
        return 0.0
    vectors = rotation_vectors(motions_between(Ts, *_far_pairs(len(Ts)))[:, :3, :3])
    return float(np.sqrt(max(np.linalg.eigvalsh(vectors.T @ vectors / len(vectors))[1], 0.0)))


def _far_pairs(n: int) -> tuple[Indices, Indices]:
    first = np.concatenate([np.arange(n)] * 3)
    shifts = np.repeat([max(n // 5, 1), max(n // 3, 1), max(n // 2, 1)], n)
    return first, (first + shifts) % n


def _usable_pose_pairs(As: Array, Bs: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The usable pairs, and which they are."""
    As, Bs = np.asarray(As, dtype=float), np.asarray(Bs, dtype=float)
    if As.ndim != 3 or As.shape[1:] != (4, 4) or As.shape != Bs.shape:
        raise CalibrationInputError(f"A {As.shape} and B {Bs.shape} must both be (n, 4, 4)")
    good = usable_poses(As) & usable_poses(Bs)
    return As[good], Bs[good], good


def _input_refusal(n: int, n_min: int, spread: float, settings: HandEyeSettings) -> HandEyeEstimate | None:
    if n < n_min:
        text = f"{n} usable pairs, at least {n_min} are needed; record more poses"
        return refused_hand_eye(CalibrationStatus.TOO_FEW, text, n)
    if not spread >= settings.axis_spread_min_rad:
        found, limit = np.rad2deg([spread, settings.axis_spread_min_rad])
        text = f"all rotations are about one axis (second axis {found:.2f} deg rms, limit {limit:.1f} deg)"
        return refused_hand_eye(
            CalibrationStatus.DEGENERATE, f"{text}; turn the hand about two different axes", n, spread
        )
    return None


def _median_norm(vectors: Array) -> float:
    return float(np.median(np.linalg.norm(vectors, axis=1)))


def _judge_estimate(
    found: RefinedHandEye, sizes: tuple[float, float], spread: float, settings: HandEyeSettings, free_offset: bool
) -> HandEyeEstimate:
    """The result, or why it may not be used."""
    n = int(np.sum(found.weights > 0.25))
    turned, missed = _median_norm(found.residuals[:, :3]), _median_norm(found.residuals[:, 3:])
    sigmas = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    sigma_rotation = float(np.linalg.norm(sigmas[:3]))
    sigma_translation = float(np.linalg.norm(sigmas[3:6]))
    offset_sigma = float(sigmas[-1]) if free_offset else 0.0
    for value, limit, text in (
        (
            np.rad2deg(turned),
            np.rad2deg(settings.residual_rotation_max_rad),
            f"rotations do not fit: residual [deg]{POSE_CONVENTION_HINT}",
        ),
        (
            1e3 * missed,
            1e3 * settings.residual_translation_max_m,
            f"translations do not fit: residual [mm]{POSE_CONVENTION_HINT}",
        ),
        (turned / max(sizes[0], 1e-9), settings.residual_relative_max, "rotations do not fit: residual over motion"),
        (missed / max(sizes[1], 1e-9), settings.residual_relative_max, "translations do not fit: residual over motion"),
        (np.rad2deg(sigma_rotation), np.rad2deg(settings.sigma_rotation_max_rad), "rotation hardly known: sigma [deg]"),
        (1e3 * sigma_translation, 1e3 * settings.sigma_translation_max_m, "translation hardly known: sigma [mm]"),
        (0.0 if found.converged else 1.0, 0.5, "the fit did not settle: flag"),
    ):
        if not value <= limit:
            reason = f"{text} {value:.2f}, limit {limit:.2f}; turn more, about two axes, and check both streams"
            return refused_hand_eye(CalibrationStatus.POOR_FIT, reason, n, spread)
    return HandEyeEstimate(
        status=CalibrationStatus.OK,
        reason="",
        T_hand_cam=found.unknowns.T_hand_cam,
        T_base_target=found.unknowns.T_base_target,
        covariance=found.covariance[:12, :12],
        residual_median_deg=float(np.rad2deg(turned)),
        residual_median_mm=1e3 * missed,
        n_used=n,
        axis_spread_rad=spread,
        time_offset_s=found.unknowns.offset_s,
        time_offset_sigma_s=offset_sigma,
    )


_PAIR_SPAN_S = 0.5  # motions compared in the offset search: long enough to stand above the noise
_SAMPLES_MIN = 12


def estimate_hand_eye(
    t_hand_s: Array,
    Ts_base_hand: Array,
    t_cam_s: Array,
    Ts_cam_target: Array,
    settings: HandEyeSettings = DEFAULT_HAND_EYE_SETTINGS,
) -> HandEyeEstimate:
    """Hand-eye pose X, target pose Y and clock offset from two streams with unknown offset.

    Model:   A(t + tau) X = Y B(t). Start: the tau within the bound at which the rotation angles of both streams agree
             best (they do not depend on X); then tau is refined with X and Y. Never searched beyond the bound: on
             repeated motion a far peak can be the higher one.
    Args:    t_hand_s (m,), Ts_base_hand (m, 4, 4); t_cam_s (n,), Ts_cam_target (n, 4, 4): target in the camera.
    Returns: the estimate with `time_offset_s` and its sigma; no pose when the streams do not determine it.
    Source:  Furrer et al. 2017 (angles for the offset); Park, Martin 1994.
    """
    require_track_shape(t_hand_s, Ts_base_hand, "hand track")
    require_track_shape(t_cam_s, Ts_cam_target, "camera track")
    wrong = time_refusal(t_hand_s, "hand track") or time_refusal(t_cam_s, "camera track")
    if wrong is not None:
        return refused_hand_eye(wrong.status, wrong.reason)
    good_hand, good_cam = usable_poses(np.asarray(Ts_base_hand)), usable_poses(np.asarray(Ts_cam_target))
    hand = HandPoses(t_hand_s[good_hand], Ts_base_hand[good_hand], settings.gap_max_s)
    good_cam &= hand.covers_times(t_cam_s, settings.offset_bound_s + 0.01)
    t_cam, Ts_cam = t_cam_s[good_cam], Ts_cam_target[good_cam]
    if len(t_cam) < _SAMPLES_MIN:
        counts = f"{len(t_cam)} camera poses lie within the hand's track, at least {_SAMPLES_MIN} are needed"
        return refused_hand_eye(CalibrationStatus.TOO_FEW, f"{counts}; record both streams", len(t_cam))
    start_s = _coarse_offset(hand, t_cam, Ts_cam, settings)
    track = inverse_poses(Ts_cam)
    found = _solve_poses(lambda offset_s: hand.poses_at(t_cam + offset_s), track, start_s, True, settings)
    if found.T_hand_cam is not None and abs(found.time_offset_s) >= settings.offset_bound_s:
        text = f"time offset {1e3 * found.time_offset_s:.0f} ms, bound {1e3 * settings.offset_bound_s:.0f} ms"
        return refused_hand_eye(
            CalibrationStatus.POOR_FIT, f"{text}; check the clocks", found.n_used, found.axis_spread_rad
        )
    text = f"time offset {1e3 * found.time_offset_s:.1f} ms, sigma {1e3 * found.time_offset_sigma_s:.1f} ms"
    return found if found.T_hand_cam is None else replace(found, reason=text)


class HandPoses:
    """The hand's poses at any time: rotation by slerp, position linear."""

    def __init__(self, t_s: Array, Ts: Array, gap_max_s: float) -> None:
        self._t_s, self._Ts, self._gap_max_s = t_s, Ts, gap_max_s
        self._slerp = Slerp(t_s, Rotation.from_matrix(Ts[:, :3, :3])) if len(t_s) >= 2 else None

    def poses_at(self, t_s: Array) -> Array:
        """Poses at times (n,) [s], held at the ends."""
        t = np.clip(t_s, self._t_s[0], self._t_s[-1])
        out = np.tile(np.eye(4), (len(t), 1, 1))
        if self._slerp is not None:
            out[:, :3, :3] = self._slerp(t).as_matrix()
        out[:, :3, 3] = np.column_stack([np.interp(t, self._t_s, self._Ts[:, axis, 3]) for axis in range(3)])
        return out

    def covers_times(self, t_s: Array, margin_s: float) -> NDArray[np.bool_]:
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
    seen = _motion_angles(Ts_cam, first, last, swapped=True)
    steps = round(settings.offset_bound_s / settings.offset_grid_s)
    grid = np.arange(-steps, steps + 1) * settings.offset_grid_s
    costs = [
        float(np.mean(np.abs(_motion_angles(hand.poses_at(t_cam + offset_s), first, last) - seen))) for offset_s in grid
    ]
    return float(grid[int(np.argmin(costs))])


def _motion_angles(Ts: Array, first: Indices, last: Indices, swapped: bool = False) -> Array:
    motions = motions_between(inverse_poses(Ts) if swapped else Ts, first, last)
    return np.linalg.norm(rotation_vectors(motions[:, :3, :3]), axis=1)
