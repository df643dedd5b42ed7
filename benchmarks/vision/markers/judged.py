"""One cell of looks judged: ratio to the bound, flips, flags, coverage. Counts, so that cells can be pooled.

The estimator is judged twice: told the noise of the corners, which no server knows, and as it is shipped.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.vision.markers.errors import deviations, split, split_covariances
from benchmarks.vision.markers.optimal import mirrored
from machine.rotations import Array

CHI2_95 = {2: 5.991, 3: 7.815}
CHI2_999_TILT = 13.816  # 2 degrees of freedom
OPTIMAL_MARGIN = 9.0
PARTS = {"tilt": (0, 1), "lateral": (3, 4), "depth": (5,)}  # of `split_axes`


@dataclass(frozen=True, slots=True)
class CellResult:
    """What came out of one cell; all counts are of looks. `known`, `shipped`: as `counts` tells them."""

    side_m: float
    distance_m: float
    tilt_deg: float
    sigma_px: float
    n: int
    tilt_bound_deg: float  # rms of the angle of the normal
    ratios: dict[str, dict[str, float]]  # method -> part -> rms over bound
    biases: dict[str, list[float]]  # part -> sums of error over its bound's sigma, one per axis
    flagged_optimal: int
    flips_opencv: int
    known: dict[str, int]  # with the noise known
    shipped: dict[str, int]  # with the server's own setting


@dataclass(frozen=True, slots=True)
class Looks:
    """Poses found in one cell: (n, 4, 4), covariances (n, 6, 6), whether flagged ambiguous (n,)."""

    Ts: Array
    covariances: Array
    flagged: NDArray[np.bool_]


def ratios(Ts: Array, truths: Array, bounds: Array, tilt_of: NDArray[np.bool_] | None = None) -> dict[str, float]:
    """Root of the summed squared errors over the summed bounds, by part; tilt over the looks `tilt_of` only."""
    good = np.isfinite(Ts).all(axis=(1, 2))
    errors = split(deviations(Ts[good], truths[good]), truths[good])
    variances = np.einsum("nii->ni", split_covariances(bounds[good], truths[good]))
    result = {}
    for name, axes in PARTS.items():
        rows = tilt_of[good] if name == "tilt" and tilt_of is not None else np.ones(len(errors), dtype=bool)
        e, v = errors[rows][:, list(axes)], variances[rows][:, list(axes)]
        result[name] = float(np.sqrt(np.sum(e**2) / np.sum(v))) if len(e) else float("nan")
    return result


def normalised_bias(Ts: Array, truths: Array, bounds: Array) -> dict[str, list[float]]:
    """Sums over the looks of error over the bound's sigma, by part and axis."""
    errors = split(deviations(Ts, truths), truths)
    sigmas = np.sqrt(np.einsum("nii->ni", split_covariances(bounds, truths)))
    sums = np.sum(errors / sigmas, axis=0)
    return {name: [float(sums[axis]) for axis in axes] for name, axes in PARTS.items()}


def counts(looks: Looks, truths: Array, tilt_deg: float, eye_middle: Array) -> dict[str, int]:
    """What the poses say of themselves, counted.

    Returns: n: poses; flagged: as ambiguous, or no pose; nearer_to_mirror: sure, and nearer to the mirrored truth;
             flips: of these, with the truth outside the pose's own 99.9 %; inside_position, inside_tilt: the truth
             inside its 95 %, the latter of n_tilt poses that are sure.
    """
    there = np.isfinite(looks.Ts).all(axis=(1, 2))
    found = Looks(looks.Ts[there], looks.covariances[there], looks.flagged[there])
    sure, tilts = ~found.flagged, tilt_chi2(found, truths[there])
    mirror = sure & nearer_to_mirror(found.Ts, truths[there], eye_middle) & (tilt_deg > 0.0)
    return {
        "n": int(there.sum()),
        "flagged": int(looks.flagged.sum()),
        "flips": int((mirror & (tilts > CHI2_999_TILT)).sum()),
        "nearer_to_mirror": int(mirror.sum()),
        "inside_position": int((position_chi2(found, truths[there]) < CHI2_95[3]).sum()),
        "inside_tilt": int((tilts[sure] < CHI2_95[2]).sum()),
        "n_tilt": int(sure.sum()),
    }


def tilt_bound_deg(truths: Array, bounds: Array) -> float:
    """Rms of the angle of the normal by the bound [deg]."""
    variances = np.einsum("nii->ni", split_covariances(bounds, truths))
    return float(np.rad2deg(np.sqrt(np.mean(variances[:, 0] + variances[:, 1]))))


def chi2(errors: Array, covariances: Array) -> Array:
    """Squared Mahalanobis lengths (n,)."""
    return np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def position_chi2(looks: Looks, truths: Array) -> Array:
    """Of the position, 3 degrees of freedom."""
    errors = deviations(looks.Ts, truths)
    return chi2(errors[:, 3:], looks.covariances[:, 3:, 3:])


def tilt_chi2(looks: Looks, truths: Array) -> Array:
    """Of the normal, 2 degrees of freedom."""
    errors = split(deviations(looks.Ts, truths), looks.Ts)
    return chi2(errors[:, :2], split_covariances(looks.covariances, looks.Ts)[:, :2, :2])


def nearer_to_mirror(Ts: Array, truths: Array, eye_middle: Array) -> NDArray[np.bool_]:
    """Whether the normal found lies nearer to the mirrored true normal than to the true one (n,)."""
    normals, true, other = Ts[:, :3, 2], truths[:, :3, 2], mirrored(truths, eye_middle)[:, :3, 2]
    return np.sum(normals * other, axis=1) > np.sum(normals * true, axis=1) + 1e-9
