"""Hand-eye calibration: A X = X B over motions, A X = Y B over poses, each with covariance, status and reason."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from server.calibration.checks import CalibrationInputError, require_covariance
from server.calibration.contracts import Array, CalibrationStatus
from server.calibration.hand_eye_contracts import HandEyeEstimate, HandEyeSettings, refused
from server.calibration.hand_eye_linear import Indices, inverse_poses, motions_between, rotation_vectors, start_ax_yb
from server.calibration.hand_eye_models import HandEyeUnknowns, HandTrack, PoseModel, WeightedModel, whiteners_of
from server.calibration.hand_eye_refinement import Refined, refine
from server.calibration.trajectory_matching_refusals import usable_poses

DEFAULT_SETTINGS = HandEyeSettings()
#: What makes residuals that no camera and no encoder have.
ORDER = " (order of Euler angles or quaternion, or a pose the wrong way round?)"


def solve_ax_yb(
    As: Array,
    Bs: Array,
    unknown_scale: bool = False,
    settings: HandEyeSettings = DEFAULT_SETTINGS,
    rng: np.random.Generator | None = None,
    camera_covariances: Array | None = None,
) -> HandEyeEstimate:
    """X and Y of A X = Y B from pairs of poses.

    Model:   best of Park-Martin on all and on random triples, then robust refinement of B^-1 = X^-1 A^-1 Y; once more
             weighted, where the images' covariances are known.
    Args:    As: base from hand, Bs: target from camera (n, 4, 4) [m]; unknown_scale: B's lengths have an unknown factor
             (one camera without a known length); rng: for the triples, seed 0 if None. camera_covariances (n, 6, 6): of
             the target in the camera, as `ObjectPose.covariance`: far and frontal poses count for less.
    Returns: the estimate; no X when the poses do not determine it.
    Raises:  CalibrationInputError: shapes.
    Source:  Park, Martin 1994; Zhuang, Roth, Sudhakar 1994 (A X = Y B).
    """
    As, Bs, good = _pairs(As, Bs)
    covariances = usable_covariances(camera_covariances, good)
    return solve_poses(lambda offset_s: As, Bs, 0.0, unknown_scale, False, settings, rng, covariances)


def usable_covariances(camera_covariances: Array | None, good: NDArray[np.bool_]) -> Array | None:
    """Covariances (n, 6, 6) of the good poses; raises CalibrationInputError: not one of each of all poses."""
    if camera_covariances is None:
        return None
    given = np.asarray(camera_covariances, dtype=float)
    if given.shape != (len(good), 6, 6):
        raise CalibrationInputError(f"camera_covariances {given.shape} must be ({len(good)}, 6, 6)")
    return np.array([require_covariance(C, 6, "camera_covariances") for C in given[good]]).reshape(-1, 6, 6)


def solve_poses(
    hand: HandTrack,
    Bs: Array,
    offset_start_s: float,
    unknown_scale: bool,
    free_offset: bool,
    settings: HandEyeSettings,
    rng: np.random.Generator | None,
    camera_covariances: Array | None = None,
) -> HandEyeEstimate:
    """A X = Y B with the hand as a function of the clock offset; `free_offset`: the offset is refined along."""
    As = hand(offset_start_s)
    spread = min(pose_axis_spread(Ts) for Ts in (As, Bs)) if len(As) else 0.0
    refusal = _refusal(len(As), settings.poses_min, spread, settings)
    if refusal is not None:
        return refusal
    X, Y = start_ax_yb(As, Bs, unknown_scale, np.random.default_rng(0) if rng is None else rng, settings.triples)
    Ts_cam_target = inverse_poses(Bs)
    scale = _start_scale(As, X, Y, Ts_cam_target) if unknown_scale else 1.0
    model = PoseModel(hand, Ts_cam_target, unknown_scale, free_offset)
    start = HandEyeUnknowns(X, Y, scale, offset_start_s)
    found = refine(model, start, settings.freedom, settings.iterations_max, unknown_scale, True)
    if camera_covariances is not None:
        weighted = WeightedModel(model, whiteners_of(camera_covariances, found.residuals, found.weights))
        again = refine(weighted, found.unknowns, settings.freedom, settings.iterations_max, unknown_scale, True)
        found = replace(again, residuals=model.evaluate(again.unknowns)[0])
    centred = Bs[:, :3, 3] - np.median(Bs[:, :3, 3], axis=0)
    turns = rotation_vectors(motions_between(Bs, *_far_pairs(len(Bs)))[:, :3, :3])
    return _judged(found, (_median_norm(turns), _median_norm(centred)), spread, settings, free_offset)


def axis_spread(Rs: Array) -> float:
    """Rms rotation about the second strongest axis of motions (n, 3, 3) [rad]: 0 when all axes are parallel."""
    vectors = rotation_vectors(Rs)
    return float(np.sqrt(max(np.linalg.eigvalsh(vectors.T @ vectors / len(vectors))[1], 0.0)))


def pose_axis_spread(Ts: Array) -> float:
    """`axis_spread` of the motions between poses (n, 4, 4) far apart in the list."""
    return axis_spread(motions_between(Ts, *_far_pairs(len(Ts)))[:, :3, :3]) if len(Ts) >= 3 else 0.0


def _far_pairs(n: int) -> tuple[Indices, Indices]:
    first = np.concatenate([np.arange(n)] * 3)
    shifts = np.repeat([max(n // 5, 1), max(n // 3, 1), max(n // 2, 1)], n)
    return first, (first + shifts) % n


def _pairs(As: Array, Bs: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The usable pairs, and which they are."""
    As, Bs = np.asarray(As, dtype=float), np.asarray(Bs, dtype=float)
    if As.ndim != 3 or As.shape[1:] != (4, 4) or As.shape != Bs.shape:
        raise CalibrationInputError(f"A {As.shape} and B {Bs.shape} must both be (n, 4, 4)")
    good = usable_poses(As) & usable_poses(Bs)
    return As[good], Bs[good], good


def _refusal(n: int, n_min: int, spread: float, settings: HandEyeSettings) -> HandEyeEstimate | None:
    if n < n_min:
        text = f"{n} usable pairs, at least {n_min} are needed; record more poses"
        return refused(CalibrationStatus.TOO_FEW, text, n)
    if not spread >= settings.axis_spread_min_rad:
        found, limit = np.rad2deg([spread, settings.axis_spread_min_rad])
        text = f"all rotations are about one axis (second axis {found:.2f} deg rms, limit {limit:.1f} deg)"
        return refused(CalibrationStatus.DEGENERATE, f"{text}; turn the hand about two different axes", n, spread)
    return None


def _start_scale(As: Array, X: Array, Y: Array, Ts_cam_target: Array) -> float:
    predicted = (inverse_poses(As @ X) @ Y)[:, :3, 3]
    ratios = np.linalg.norm(Ts_cam_target[:, :3, 3], axis=1) / np.maximum(np.linalg.norm(predicted, axis=1), 1e-9)
    return float(np.median(ratios))


def _median_norm(vectors: Array) -> float:
    return float(np.median(np.linalg.norm(vectors, axis=1)))


def _judged(
    found: Refined, sizes: tuple[float, float], spread: float, settings: HandEyeSettings, free_offset: bool
) -> HandEyeEstimate:
    """The result, or why it may not be used."""
    n = int(np.sum(found.weights > 0.25))
    turned, missed = _median_norm(found.residuals[:, :3]), _median_norm(found.residuals[:, 3:])
    sigmas = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    with_Y = found.unknowns.Y is not None
    sigma_rotation = float(np.linalg.norm(sigmas[:3]))
    sigma_translation = float(np.linalg.norm(sigmas[3:6]))
    offset_sigma = float(sigmas[-1]) if free_offset else 0.0
    for value, limit, text in (
        (
            np.rad2deg(turned),
            np.rad2deg(settings.residual_rotation_max_rad),
            f"rotations do not fit: residual [deg]{ORDER}",
        ),
        (1e3 * missed, 1e3 * settings.residual_translation_max_m, f"translations do not fit: residual [mm]{ORDER}"),
        (turned / max(sizes[0], 1e-9), settings.residual_relative_max, "rotations do not fit: residual over motion"),
        (missed / max(sizes[1], 1e-9), settings.residual_relative_max, "translations do not fit: residual over motion"),
        (np.rad2deg(sigma_rotation), np.rad2deg(settings.sigma_rotation_max_rad), "rotation hardly known: sigma [deg]"),
        (1e3 * sigma_translation, 1e3 * settings.sigma_translation_max_m, "translation hardly known: sigma [mm]"),
        (0.0 if found.settled else 1.0, 0.5, "the fit did not settle: flag"),
    ):
        if not value <= limit:
            reason = f"{text} {value:.2f}, limit {limit:.2f}; turn more, about two axes, and check both streams"
            return refused(CalibrationStatus.POOR_FIT, reason, n, spread)
    size = 12 if with_Y else 6
    return HandEyeEstimate(
        status=CalibrationStatus.OK,
        reason="",
        X=found.unknowns.X,
        Y=found.unknowns.Y,
        covariance=found.covariance[:size, :size],
        residual_median_deg=float(np.rad2deg(turned)),
        residual_median_mm=1e3 * missed,
        n_used=n,
        axis_spread_rad=spread,
        scale=found.unknowns.scale,
        time_offset_s=found.unknowns.offset_s,
        time_offset_sigma_s=offset_sigma,
    )
