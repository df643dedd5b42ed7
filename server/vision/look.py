"""One look from many pairs: rest is checked, outliers are cut, and a failed look says what to do."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from server.vision.contracts import Array, Look, LookStatus, ObjectPose, PairObservation, PoseStatus
from server.vision.pose_mean import MAD_TO_SIGMA, PoseMean, pose_mean

SPREAD_SIGMAS, DRIFT_SIGMAS = 2.0, 4.0  # of the predicted noise: more is motion, whatever the limits in mm say
USABLE = (PoseStatus.OK, PoseStatus.ORIENTATION_AMBIGUOUS)


@dataclass(frozen=True, slots=True)
class AverageSettings:
    """When pairs make a look."""

    spread_max_mm: float = 1.0  # robust spread of the tool-to-OOI position over the pairs
    drift_max_mm: float = 1.0  # first third against last third of the window
    used_min_frac: float = 0.5  # pairs that must show both objects


@dataclass(frozen=True, slots=True)
class Rest:
    """Spread and drift of the tool-to-OOI position over the window [mm]."""

    spread_mm: float
    drift_mm: float


def average_look(
    observations: Sequence[PairObservation], spread_max_mm: float = 1.0, settings: AverageSettings | None = None
) -> Look:
    """Robust mean of tool and OOI in the left camera over pairs taken at rest.

    Model:   rest: p = position of tool minus OOI per pair; spread = 1.4826 median |p - median|,
             drift = |median of the last third - of the first|; a limit below the predicted noise is raised to it.
             Then `pose_mean` for each object.
    Args:    observations: pairs in order of exposure. spread_max_mm: limit of spread and drift [mm] without `settings`.
    Returns: Look; its poses are None unless status is OK or ORIENTATION_AMBIGUOUS.
    """
    limits = settings or AverageSettings(spread_max_mm=spread_max_mm, drift_max_mm=spread_max_mm)
    if not observations:
        return _failed(
            observations, LookStatus.NO_IMAGES, "no stereo pairs received; check the camera source and its cable"
        )
    usable = [pair for pair in observations if pair.tool.status in USABLE and pair.ooi.status in USABLE]
    if len(usable) < max(1.0, limits.used_min_frac * len(observations)):
        return _failed(observations, *_why_unusable(observations))
    rest = _rest(usable)
    noise_mm = _noise_mm(usable)  # far markers scatter by more than the limits without any motion
    spread_max_mm = max(limits.spread_max_mm, SPREAD_SIGMAS * noise_mm)
    drift_max_mm = max(limits.drift_max_mm, DRIFT_SIGMAS * noise_mm / np.sqrt(max(1.0, len(usable) / 3.0)))
    if rest.spread_mm > spread_max_mm or rest.drift_mm > drift_max_mm:
        reason = (
            f"tool moves against the OOI: spread {rest.spread_mm:.2f} mm (limit {spread_max_mm:.2g} mm), drift "
            f"{rest.drift_mm:.2f} mm (limit {drift_max_mm:.2g} mm) over {len(usable)} pairs; "
            "wait until the boom rests"
        )
        return _failed(observations, LookStatus.NOT_AT_REST, reason, rest.spread_mm)
    clear = [pair for pair in usable if pair.tool.status is PoseStatus.OK and pair.ooi.status is PoseStatus.OK]
    ambiguous = len(clear) < limits.used_min_frac * len(usable)
    return _averaged(observations, usable if ambiguous else clear, rest, ambiguous)


def _averaged(
    observations: Sequence[PairObservation], taken: Sequence[PairObservation], rest: Rest, ambiguous: bool
) -> Look:
    tool, ooi = _mean_of([pair.tool for pair in taken]), _mean_of([pair.ooi for pair in taken])
    both = tool.kept & ooi.kept
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
        spread_mm=rest.spread_mm,
        corners_px=_mean_corners(taken),
    )


def _mean_corners(taken: Sequence[PairObservation]) -> dict[int, tuple[Array | None, Array | None]]:
    """Median corners (4, 2) [raw px] of each marker in each eye, over the pairs that used it."""
    views = [view for pair in taken for view in pair.views if view.used]
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


def _rest(observations: Sequence[PairObservation]) -> Rest:
    positions_mm = _vectors_m(observations) * 1e3
    distance = np.linalg.norm(positions_mm - np.median(positions_mm, axis=0), axis=1)
    third = max(1, len(positions_mm) // 3)
    first, last = np.median(positions_mm[:third], axis=0), np.median(positions_mm[-third:], axis=0)
    return Rest(MAD_TO_SIGMA * float(np.median(distance)), float(np.linalg.norm(last - first)))


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
    status = LookStatus.TOOL_NOT_SEEN if unseen[-1].on == "tool" else LookStatus.OOI_NOT_SEEN
    return status, f"tool and OOI together in too few of {n} pairs: {unseen[-1].reason}"


def _failed(
    observations: Sequence[PairObservation], status: LookStatus, reason: str, spread_mm: float = float("nan")
) -> Look:
    return Look(
        status=status,
        reason=reason,
        T_cam_tool=None,
        T_cam_ooi=None,
        tool_covariance=None,
        ooi_covariance=None,
        n_pairs=len(observations),
        n_used=0,
        t_first_ns=observations[0].t_exposure_ns if observations else 0,
        t_last_ns=observations[-1].t_exposure_ns if observations else 0,
        spread_mm=spread_mm,
    )
