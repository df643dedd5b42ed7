"""Points at rest that no model of the arm comes near: a wrong row, a prism that was hit, a pose not yet reached.

Why: one of them half a metre off widens the noise of all others, and what they would have shown is lost in it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.link_angles import without_encoders
from diagnosis.behind.points import PointData, fit_points, static_data, usable_rows
from diagnosis.behind.saturated import mixture_directions
from diagnosis.log.findings import Finding
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import PointTable
from diagnosis.search.candidates import arm_candidates
from machine.effects.encoders import true_angles
from machine.effects.entries import pack_under
from machine.effects.layout import ParameterSets
from machine.rotations import Array

MIXTURE_DIRECTIONS_MAX_FRAC = 0.25  # of the numbers: a mixture of more directions may follow any point
OUTLIER_SIGMAS = 20.0  # the others' own scatter about the mixture
# The others' distance from the nominal model: what is small against it may be mere curvature
OUTLIER_MEDIAN_DISTANCE_RATIO = 0.3
OUTLIER_MIN_M = 2e-4
SCATTER_MIN_M = 1e-6
POINTS_MIN = 20
OUTLIER_MAX_FRAC = 0.05  # of the points: if more are outside, it is the model that is wrong
OUTLIER_BATCH_DISTANCE_FRAC = 0.5  # of the farthest: what is nearer may only have been moved by it
# Times the farthest that stays: nearer ones are the tail of what all poses share, play say
OUTLIER_TO_INLIER_RATIO_MIN = 2.0
MAX_ITERATIONS = 12
REWEIGHTING_ITERATIONS = 12
NORMAL_3D_MEDIAN_NORM = 1.538  # median length of three normal numbers
OUTLIERS_NAMED_MAX = 3


@dataclass(frozen=True, slots=True)
class _MixtureDistances:
    """How far each point (m,) is from the nearest mixture, the scatter of the others, and their distance [m]."""

    distance_m: Array
    scatter_sigma_m: float
    nominal_distance_median_m: float

    @property
    def outlying_points(self) -> NDArray[np.bool_]:
        """Which points are no scatter (m,), the farthest ones first."""
        least = max(
            OUTLIER_SIGMAS * self.scatter_sigma_m,
            OUTLIER_MEDIAN_DISTANCE_RATIO * self.nominal_distance_median_m,
            OUTLIER_MIN_M,
        )
        return self.distance_m > max(least, OUTLIER_BATCH_DISTANCE_FRAC * float(self.distance_m.max()))

    def are_far_from(self, rest: "_MixtureDistances") -> bool:
        """Whether the outside points are far from all that stay; `rest` describes these."""
        return float(self.distance_m[self.outlying_points].min()) > OUTLIER_TO_INLIER_RATIO_MIN * float(
            rest.distance_m.max()
        )


def without_outlying(nominal: Nominal, table: PointTable) -> tuple[PointTable, list[Finding]]:
    """Points at rest without those that lie outside, which are named.

    Model: one linear step in all effects together, points weighed by 1 / (1 + (distance / scatter)^2) in turn; outside
           is what lies twenty scatters away. The farthest are taken out and the rest is looked at again, since a frame
           that was fitted through them moves all others, until a twentieth of all would be out. Those that were taken
           out last come back while they are not twice as far as what stays.
    """
    rounds, left, away = [], table, np.zeros(len(table.xyz))
    off = _static_point_outliers(nominal, left)
    while left.q is not None and off is not None and off.outlying_points.any() and len(rounds) < MAX_ITERATIONS:
        rows = np.nonzero(usable_rows(nominal, left, left.q))[0][off.outlying_points]
        further = away.copy()
        further[rows] = off.distance_m[off.outlying_points]
        if (further > 0.0).sum() > OUTLIER_MAX_FRAC * len(off.distance_m):
            break
        rounds.append((left, away, off))
        left, away = left.without_rows(rows), further
        off = _static_point_outliers(nominal, left)
    while rounds and off is not None and not rounds[-1][2].are_far_from(off):
        left, away, off = rounds.pop()
    return left, [_outlier_finding(table, away)] if rounds else []


def _static_point_outliers(nominal: Nominal, table: PointTable) -> _MixtureDistances | None:
    data = None if nominal.arm is None else static_data(nominal, table)
    return None if data is None else _unexplained_distances(nominal, data)


def _unexplained_distances(nominal: Nominal, data: PointData) -> _MixtureDistances | None:
    """None where too few points were measured, or the frame cannot be fitted."""
    if len(data.xyz) < POINTS_MIN:
        return None

    def residual(sets: ParameterSets) -> Array:
        turned = (replace(data, q=true_angles(sets, data.q, k)) for k in range(sets.set_count))
        plain = without_encoders(sets)
        return np.array([fit_points(nominal, plain, points, k).residual_m.ravel() for k, points in enumerate(turned)])

    joints = tuple(range(1, nominal.n + 1))
    r0, u = mixture_directions(
        residual, pack_under(nominal.baseline_effects, nominal.n), arm_candidates(joints, moving=False)
    )
    u = u[:, : int(MIXTURE_DIRECTIONS_MAX_FRAC * len(r0))]
    weight, away, scatter = np.ones(len(data.xyz)), np.zeros(len(data.xyz)), 0.0
    for _ in range(REWEIGHTING_ITERATIONS):
        w = np.repeat(np.sqrt(weight), 3)
        step = np.linalg.lstsq(u * w[:, None], r0 * w, rcond=None)[0]
        away = np.linalg.norm((r0 - u @ step).reshape(-1, 3), axis=1)
        scatter = float(np.median(away)) / NORMAL_3D_MEDIAN_NORM
        weight = 1.0 / (1.0 + (away / max(scatter, SCATTER_MIN_M)) ** 2)
    return _MixtureDistances(away, scatter, float(np.median(np.linalg.norm(r0.reshape(-1, 3), axis=1))))


def _outlier_finding(table: PointTable, away: Array) -> Finding:
    worst = [k for k in np.argsort(-away, kind="stable") if away[k] > 0.0]
    worst_points = ", ".join(
        f"{table.point_names[k]} in pose {table.t_s[k]:.0f} by {away[k]:.3g} m" for k in worst[:OUTLIERS_NAMED_MAX]
    )
    more = f" and {len(worst) - OUTLIERS_NAMED_MAX} more" if len(worst) > OUTLIERS_NAMED_MAX else ""
    text = (
        f"{len(worst)} of {len(away)} points lie where no model of this arm puts them, beyond the others' scatter: "
        f"{worst_points}{more}; they are left out: measure those poses again"
    )
    return Finding("outlying_points", "problem", "static.csv", text, len(worst))
