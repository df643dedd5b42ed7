"""One look from many pairs: rest is checked, outliers are cut, and a failed look says what to do."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.poses import pose
from machine.rotations import nearest_rotation, rotation_from_rotvec, rotvec_from_rotation
from server.vision.contracts import Array, Look, LookStatus, ObjectPose, PairObservation, PoseStatus

ITERATIONS_MAX = 20
MAD_TO_SIGMA = 1.4826
OUTLIER_CHI2 = 16.3  # 3 degrees of freedom, 99.9 %
CHI2_3DOF_MEDIAN = 2.366
SCATTER_POSES_MIN = 8  # fewer poses do not show their own scatter
TRACY_WIDOM_99 = 2.02
SHARED_CORRELATION_SIGMAS = 2.33 / np.sqrt(6.0)  # standard errors of a correlation that six axes share: 1 %
AXIS_CORRELATION_SIGMAS = 1.645  # of one axis alone: 5 %, for a drift that is passed over costs more than a few poses


@dataclass(frozen=True, slots=True)
class PoseMean:
    """Mean pose, covariance of the mean (6, 6) (rotation [rad] left perturbation, position [m]), who was kept (n,)."""

    T_mean: Array
    covariance: Array
    inliers: NDArray[np.bool_]


def pose_deviations(Ts: Array, T_mean: Array) -> Array:
    """Deviations (n, 6) of poses (n, 4, 4) from a mean: rotvec of R R_mean^T [rad], then position difference [m]."""
    rotations = np.array([rotvec_from_rotation(T[:3, :3] @ T_mean[:3, :3].T) for T in Ts])
    return np.concatenate([rotations, Ts[:, :3, 3] - T_mean[:3, 3]], axis=1)


def _mean_pose(Ts: Array, start: Array) -> Array:
    """Karcher mean of the rotations, arithmetic mean of the positions."""
    rotation = start
    for _ in range(ITERATIONS_MAX):
        step = np.mean([rotvec_from_rotation(T[:3, :3] @ rotation.T) for T in Ts], axis=0)
        rotation = rotation_from_rotvec(step) @ rotation
        if np.linalg.norm(step) < 1e-12:
            break
    return pose(nearest_rotation(rotation), Ts[:, :3, 3].mean(axis=0))


def _medoid_rotation(Ts: Array) -> Array:
    """The rotation with the smallest sum of angles to the others: a start that outliers cannot pull away."""
    rotations = Ts[:, :3, :3]
    cosines = (np.einsum("aij,bij->ab", rotations, rotations) - 1.0) / 2.0
    return rotations[int(np.argmin(np.arccos(np.clip(cosines, -1.0, 1.0)).sum(axis=1)))]


def pose_mean(Ts: Array, covariances: Array) -> PoseMean:
    """Mean pose with outliers cut, and its covariance.

    Model:   deviations from the median pose, whitened by each pose's own covariance; a pose is out where position or
             rotation lies beyond chi2_3 = 16.3 (99.9 %), scaled up where the median says that all scatter more; then
             Karcher mean of the rest, unweighted: a covariance depends on its own pose's error, so weights would pull.
             Covariance: mean of the predicted ones, grown where the scatter refutes them at 1 % (as a whole, or along
             axes), over the effective number of poses, n (1 - r) / (1 + r) where neighbours in time correlate by r, in
             all axes or in one.
    Args:    Ts: poses (n, 4, 4) in order of time, n >= 1. covariances: their predicted covariances (n, 6, 6).
    Returns: PoseMean.
    Source:  Karcher 1977 (mean of rotations); Johnstone 2001 (largest eigenvalue of a white scatter matrix);
             Bartlett 1946 (effective number).
    """
    start = pose(_medoid_rotation(Ts), np.median(Ts[:, :3, 3], axis=0))
    from_start = pose_deviations(Ts, start)
    kept = np.ones(len(Ts), dtype=bool)
    for block in (slice(0, 3), slice(3, 6)):
        part = from_start[:, block]
        chi2 = np.sum(part * np.linalg.solve(covariances[:, block, block], part[..., None])[..., 0], axis=1)
        kept &= chi2 <= OUTLIER_CHI2 * max(float(np.median(chi2)) / CHI2_3DOF_MEDIAN, 1.0)
    if not kept.any():
        kept[:] = True
    T_mean = _mean_pose(Ts[kept], start[:3, :3])
    return PoseMean(T_mean, _covariance_of_mean(pose_deviations(Ts[kept], T_mean), covariances[kept]), kept)


def _covariance_of_mean(residuals: Array, covariances: Array) -> Array:
    n = len(residuals)
    predicted = covariances.mean(axis=0)
    if n < SCATTER_POSES_MIN:
        return predicted / n
    root = np.linalg.cholesky(predicted + 1e-18 * np.eye(6))
    white = np.linalg.solve(root, residuals.T).T
    values, vectors = np.linalg.eigh(white.T @ white / (n - 1))
    dof = 6 * (n - 1)
    overall = fitted_scale(float(values.sum()) / 6.0, dof)
    grown = np.where(values > overall * white_eigenvalue_max(n - 1), values, overall)
    axes = root / np.sqrt(_effective_numbers(white)) @ vectors
    return (axes * grown) @ axes.T


def fitted_scale(chi2_per_dof: float, dof: int) -> float:
    """By how much the scatter exceeds the prediction; 1 unless it refutes it at the 1 % level."""
    limit = (1.0 - 2.0 / (9.0 * dof) + 2.326 * np.sqrt(2.0 / (9.0 * dof))) ** 3  # Wilson and Hilferty 1931, 99 %
    return chi2_per_dof if chi2_per_dof > limit else 1.0


def white_eigenvalue_max(dof: int, size: int = 6) -> float:
    """What the largest eigenvalue of a white scatter matrix stays below in 99 % of cases (Johnstone 2001)."""
    a, b = np.sqrt(dof - 0.5), np.sqrt(size - 0.5)
    return float(((a + b) ** 2 + TRACY_WIDOM_99 * (a + b) * (1.0 / a + 1.0 / b) ** (1.0 / 3.0)) / dof)


def _effective_numbers(white: Array) -> Array:
    """How many independent poses these (n, 6) are worth along each whitened axis (6,).

    All six together show a weak correlation that they share; one axis alone shows its own drift, which six would hide.
    """
    n = len(white)
    products, squares = np.sum(white[1:] * white[:-1], axis=0), np.sum(white**2, axis=0)
    shared = _effective_sample_size(float(products.sum() / max(squares.sum(), 1e-30)), n, SHARED_CORRELATION_SIGMAS)
    own = [
        _effective_sample_size(float(p / max(q, 1e-30)), n, AXIS_CORRELATION_SIGMAS)
        for p, q in zip(products, squares, strict=True)
    ]
    return np.minimum(shared, own)


def _effective_sample_size(r: float, n: int, limit: float) -> float:
    """n independent values, or fewer where neighbours in time correlate by r, if that is beyond limit / sqrt(n)."""
    if r + 1.0 / n < limit / np.sqrt(n):
        return float(n)
    r = min((r + 1.0 / n) * n / max(n - 3.0, 1.0), 1.0)  # a short series shows less of its correlation: Kendall 1954
    return max(n * (1.0 - r) / (1.0 + r), 1.0)


SPREAD_SIGMAS, DRIFT_SIGMAS = 2.0, 4.0  # of the predicted noise: more is motion, whatever the limits in mm say
USED_PAIRS_MIN_FRAC = 0.5  # of the pairs: so many must show both objects
USABLE_POSE_STATUSES = (PoseStatus.OK, PoseStatus.ORIENTATION_AMBIGUOUS)


def average_look(observations: Sequence[PairObservation], spread_max_mm: float = 1.0) -> Look:
    """Robust mean of tool and OOI in the left camera over pairs taken at rest.

    Model:   rest: p = position of tool minus OOI per pair; spread = 1.4826 median |p - median|,
             drift = |median of the last third - of the first|; a limit below the predicted noise is raised to it.
             Then `pose_mean` for each object.
    Args:    observations: pairs in order of exposure. spread_max_mm: limit of spread and drift [mm].
    Returns: Look; its poses are None unless status is OK or ORIENTATION_AMBIGUOUS.
    """
    if not observations:
        reason = "no stereo pairs received; check the camera source and its cable"
        return _failed_look(observations, LookStatus.NO_IMAGES, reason)
    usable = [
        pair
        for pair in observations
        if pair.tool.status in USABLE_POSE_STATUSES and pair.ooi.status in USABLE_POSE_STATUSES
    ]
    if len(usable) < max(1.0, USED_PAIRS_MIN_FRAC * len(observations)):
        return _failed_look(observations, *_why_unusable(observations))
    spread_mm, drift_mm = _spread_and_drift_mm(usable)
    noise_mm = _noise_mm(usable)  # far markers scatter by more than the limits without any motion
    drift_max_mm = max(spread_max_mm, DRIFT_SIGMAS * noise_mm / np.sqrt(max(1.0, len(usable) / 3.0)))
    spread_max_mm = max(spread_max_mm, SPREAD_SIGMAS * noise_mm)
    if spread_mm > spread_max_mm or drift_mm > drift_max_mm:
        reason = (
            f"tool moves against the OOI: spread {spread_mm:.2f} mm (limit {spread_max_mm:.2g} mm), drift "
            f"{drift_mm:.2f} mm (limit {drift_max_mm:.2g} mm) over {len(usable)} pairs; "
            "wait until the boom rests"
        )
        return _failed_look(observations, LookStatus.NOT_AT_REST, reason, spread_mm)
    clear = [pair for pair in usable if pair.tool.status is PoseStatus.OK and pair.ooi.status is PoseStatus.OK]
    ambiguous = len(clear) < USED_PAIRS_MIN_FRAC * len(usable)
    return _averaged_look(observations, usable if ambiguous else clear, spread_mm, ambiguous)


def _averaged_look(
    observations: Sequence[PairObservation], taken: Sequence[PairObservation], spread_mm: float, ambiguous: bool
) -> Look:
    tool, ooi = _mean_of([pair.tool for pair in taken]), _mean_of([pair.ooi for pair in taken])
    both = tool.inliers & ooi.inliers
    reason = ""
    if ambiguous:
        reason = next(
            (found.reason for pair in taken for found in (pair.tool, pair.ooi) if found.status is not PoseStatus.OK), ""
        )
    return Look(
        status=LookStatus.ORIENTATION_AMBIGUOUS if ambiguous else LookStatus.OK,
        reason=reason,
        T_cam_tool=tool.T_mean,
        T_cam_ooi=ooi.T_mean,
        tool_covariance=tool.covariance,
        ooi_covariance=ooi.covariance,
        n_pairs=len(observations),
        n_used=int(both.sum()),
        t_first_ns=observations[0].t_exposure_ns,
        t_last_ns=observations[-1].t_exposure_ns,
        spread_mm=spread_mm,
        corners_px=_mean_corners(taken),
    )


def _mean_corners(taken: Sequence[PairObservation]) -> dict[int, tuple[Array | None, Array | None]]:
    """Median corners (4, 2) [raw px] of each marker in each eye, over the pairs that used it."""
    views = [view for pair in taken for view in pair.marker_views if view.used]
    found: dict[int, tuple[Array | None, Array | None]] = {}
    for marker_id in sorted({view.marker_id for view in views}):
        own = [view for view in views if view.marker_id == marker_id]
        left, right = [view.corners_left_px for view in own], [view.corners_right_px for view in own]
        found[marker_id] = _median_corners(left), _median_corners(right)
    return found


def _median_corners(seen: Sequence[Array | None]) -> Array | None:
    whole = [px for px in seen if px is not None and px.shape == (4, 2)]
    return np.median(whole, axis=0) if whole else None


def _mean_of(found: Sequence[ObjectPose]) -> PoseMean:
    Ts = np.array([pose.T_cam_object for pose in found])
    return pose_mean(Ts, np.array([pose.covariance for pose in found]))


def _vectors_m(observations: Sequence[PairObservation]) -> Array:
    """From OOI to tool (n, 3) [m] in camera axes: at rest these do not turn, and the OOI's jitter has no lever arm."""
    tools = np.array([pair.tool.T_cam_object for pair in observations])
    oois = np.array([pair.ooi.T_cam_object for pair in observations])
    return tools[:, :3, 3] - oois[:, :3, 3]


def _spread_and_drift_mm(observations: Sequence[PairObservation]) -> tuple[float, float]:
    """Of the tool-to-OOI position over the window."""
    positions_mm = _vectors_m(observations) * 1e3
    distance = np.linalg.norm(positions_mm - np.median(positions_mm, axis=0), axis=1)
    third = max(1, len(positions_mm) // 3)
    first, last = np.median(positions_mm[:third], axis=0), np.median(positions_mm[-third:], axis=0)
    return MAD_TO_SIGMA * float(np.median(distance)), float(np.linalg.norm(last - first))


def _noise_mm(observations: Sequence[PairObservation]) -> float:
    """Predicted sigma of the tool-to-OOI position of one pair, all axes together [mm]; median over the pairs."""
    both = [(pair.tool.covariance, pair.ooi.covariance) for pair in observations]
    squares = [
        np.trace(tool[3:, 3:]) + np.trace(ooi[3:, 3:]) for tool, ooi in both if tool is not None and ooi is not None
    ]
    return 1e3 * float(np.sqrt(np.median(squares))) if squares else 0.0


def _why_unusable(observations: Sequence[PairObservation]) -> tuple[LookStatus, str]:
    n = len(observations)
    for name, status in (("tool", LookStatus.TOOL_NOT_SEEN), ("ooi", LookStatus.OOI_NOT_SEEN)):
        found = [pair.tool if name == "tool" else pair.ooi for pair in observations]
        missing = [pose for pose in found if pose.status is PoseStatus.NOT_SEEN]
        if 2 * len(missing) > n:
            return status, f"{name} not seen in {len(missing)} of {n} pairs: {missing[-1].reason}"
    rejected = [
        found for pair in observations for found in (pair.tool, pair.ooi) if found.status is PoseStatus.REJECTED
    ]
    if rejected:
        return LookStatus.REJECTED, f"{len(rejected)} poses rejected in {n} pairs: {rejected[-1].reason}"
    unseen = [found for pair in observations for found in (pair.tool, pair.ooi) if found.status is PoseStatus.NOT_SEEN]
    status = LookStatus.TOOL_NOT_SEEN if unseen[-1].object_name == "tool" else LookStatus.OOI_NOT_SEEN
    return status, f"tool and OOI together in too few of {n} pairs: {unseen[-1].reason}"


def _failed_look(
    observations: Sequence[PairObservation], status: LookStatus, reason: str, spread_mm: float = float("nan")
) -> Look:
    return Look(
        status=status,
        reason=reason,
        n_pairs=len(observations),
        t_first_ns=observations[0].t_exposure_ns if observations else 0,
        t_last_ns=observations[-1].t_exposure_ns if observations else 0,
        spread_mm=spread_mm,
    )
