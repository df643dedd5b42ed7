"""The noise of points that were measured again in one pose, and whether one of them moved by itself."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.loose_point import loose_point
from diagnosis.behind.point_residual import PointResidual
from machine.effects.layout import ParameterSets
from machine.rotations import Array

NOISE_MAX_M = 0.02  # no instrument that measures an arm scatters more: two points of one name, say
SAME_POSTURE_TOLERANCE_RAD = 2e-3
MOTION_DIRECTION_WINDOW_S = 0.2  # over which the direction of motion is taken: backlash differs by it, and is not noise
FEW_AT_REST, FEW_IN_MOTION = 4, 8  # points measured again for a floor at all: in motion some are so by chance
PER_AXIS_SIGMA_DOF_MIN = 12  # for one of each axis
SHARED_VARIANCE_MAX_FRAC = 0.9  # of a pose's variance, by all its points: some of it is each one's own


@dataclass(frozen=True, slots=True)
class MeasuredAgain:
    """Standard deviations (3,) [m] of a point, of which `common_m` is a shift that all points of one pose share;
    `sigma_dof`: how many independent squares it was found from, `pointwise_dof`: how many counted point by point;
    `loose_target_text`: which point moved by itself, in words.
    """

    sigma_m: Array
    common_m: float
    sigma_dof: int
    pointwise_dof: int
    loose_target_text: str

    @property
    def own_offset(self) -> Array:
        """What is each point's own (3,) [m]."""
        return np.sqrt(self.sigma_m**2 - self.common_m**2)


def measured_again(rough: PointResidual, base: ParameterSets) -> MeasuredAgain | None:
    """From deviations of the residual where one point was measured again in the same pose.

    None if it hardly was, or where they differ by more than noise can.
    """
    residual = rough(base)[0].reshape(-1, 3)
    direction = _motion_directions(rough)
    points = rough.nominal_machine.tracked_points
    of_point, again = np.zeros((len(points), 3)), np.zeros(len(points), dtype=np.int64)
    deviation = np.zeros_like(residual)
    repeated = np.zeros(len(residual), dtype=bool)
    left = set(range(len(residual)))
    while left:
        first = left.pop()
        q, which = rough.measured_points.q[first], rough.measured_points.point_index[first]
        same = [
            k
            for k in left
            if rough.measured_points.point_index[k] == which
            and np.abs(rough.measured_points.q[k] - q).max() < SAME_POSTURE_TOLERANCE_RAD
            and bool((direction[k] == direction[first]).all())
        ]
        left -= set(same)
        group = [first, *same]
        deviation[group] = residual[group] - residual[group].mean(axis=0)
        repeated[group] = len(same) > 0
        of_point[which] += (deviation[group] ** 2).sum(axis=0)
        again[which] += len(same)
    squares, dof = of_point.sum(axis=0), int(again.sum())
    if dof < (FEW_IN_MOTION if rough.encoder_paths else FEW_AT_REST):
        return None
    places = [(point.joint, point.name) for point in points]
    loose = "" if rough.encoder_paths else loose_point(of_point.sum(axis=1), again, *zip(*places, strict=True))
    sigma = np.sqrt(squares / dof if dof >= PER_AXIS_SIGMA_DOF_MIN else np.full(3, squares.mean() / dof))
    if sigma.max() > NOISE_MAX_M:
        return None
    together = 0.0 if loose else _shared_variance_fraction(deviation[repeated], rough.noise.instant_index[repeated])
    per_pose = dof / float(again.max())  # points measured in a pose
    common_m = float(np.sqrt(together) * sigma.min())
    independent = 3.0 * dof / (1.0 + (per_pose - 1.0) * together)
    return MeasuredAgain(sigma, common_m, round(independent), 3 * dof, loose)


def _shared_variance_fraction(deviation: Array, instants: NDArray[np.int64]) -> float:
    """The share of the variance of deviations (m, 3) [m] that all points of one instant have alike, 0 to
    SHARED_VARIANCE_MAX_FRAC.

    Why: what an encoder's step hides moves all that lies beyond its joint. Counted point by point such a pose would
         speak as often as it has points.
    """
    number = np.unique(instants, return_inverse=True)[1]
    count = np.bincount(number)
    pairs = 3.0 * float((count * (count - 1)).sum())
    if pairs == 0.0:
        return 0.0
    products = sum(float((np.bincount(number, weights=x) ** 2).sum() - x @ x) for x in deviation.T)
    return float(np.clip(products / pairs / np.mean(deviation**2), 0.0, SHARED_VARIANCE_MAX_FRAC))


def _motion_directions(rough: PointResidual) -> Array:
    """Sign of each joint's motion (m, n); 0 for poses at rest."""
    out = np.zeros_like(rough.measured_points.q)
    for k, path in enumerate(rough.encoder_paths):
        rows = rough.path_index == k
        t = rough.measured_points.time_or_pose_index[rows]
        for j in range(out.shape[1]):
            now, before = (
                np.interp(when, path.t_s, path.encoder_angles[:, j]) for when in (t, t - MOTION_DIRECTION_WINDOW_S)
            )
            out[rows, j] = np.sign(np.where(np.abs(now - before) > 1e-3, now - before, 0.0))
    return out
