"""The noise of measured points: each one's own along radius, across and up, an oscillation of the slew that all points
of one instant share, and a shift that they share.

Why: a slewing arm oscillates, and all its points go across with it, each by its reach. Counted point by point such an
instant would speak three times, and any small effect at the slew would win.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machine.rotations import Array

TANGENTIAL_AXIS = 1  # of radial, tangential, up


@dataclass(frozen=True, slots=True)
class PointNoise:
    """Standard deviations `point_sigma_m` (3,), `oscillation_rad` and, of the shift, `common_m`; of each point
    `reach_m` (m,) and its instant's number.
    """

    point_sigma_m: Array
    oscillation_rad: float
    reach_m: Array
    instant_index: NDArray[np.int64]
    common_m: float = 0.0

    def whiten(self, rows: Array) -> Array:
        """White residuals (sets, 3 m) of residuals [m].

        Model: across, covariance own^2 I + psi^2 rho rho' over the reaches rho of an instant, whose inverse root
               takes what lies along rho down to own / sqrt(own^2 + psi^2 |rho|^2) of it; along each axis the same of
               a shift, which all points have alike.
        """
        out = rows.reshape(len(rows), -1, 3) / self.point_sigma_m
        if self.oscillation_rad > 0.0:
            size2 = np.bincount(self.instant_index, weights=self.reach_m**2)
            share = 1.0 - 1.0 / np.sqrt(1.0 + (self.oscillation_rad / self.point_sigma_m[TANGENTIAL_AXIS]) ** 2 * size2)
            for across in out[:, :, TANGENTIAL_AXIS]:
                along = np.bincount(self.instant_index, weights=self.reach_m * across) / np.maximum(size2, 1e-12)
                across -= self.reach_m * (share * along)[self.instant_index]
        if self.common_m > 0.0:
            count = np.bincount(self.instant_index)
            for axis, own in enumerate(self.point_sigma_m):
                share = 1.0 - 1.0 / np.sqrt(1.0 + (self.common_m / own) ** 2 * count)
                for rows_of_axis in out[:, :, axis]:
                    mean = np.bincount(self.instant_index, weights=rows_of_axis) / np.maximum(count, 1)
                    rows_of_axis -= (share * mean)[self.instant_index]
        return out.reshape(len(rows), -1)

    def with_more(self, reach_m: Array, per_instant: int) -> "PointNoise":
        """The same with more points, so many at each new instant."""
        first = int(self.instant_index.max(initial=-1)) + 1
        instants = np.concatenate([self.instant_index, first + np.arange(len(reach_m)) // per_instant])
        return replace(self, reach_m=np.concatenate([self.reach_m, reach_m]), instant_index=instants)


def instants_of(when: Array) -> NDArray[np.int64]:
    """Number of the instant at which each point was measured (m,)."""
    return np.unique(np.round(when, 6), return_inverse=True)[1].astype(np.int64).reshape(-1)


def variances_of(residual: Array, noise: PointNoise) -> tuple[Array, float]:
    """Variances (3,) [m^2] of each point's own residual (m, 3) [m], and of the oscillation [rad^2], which chance can
    bring below 0. Points that were measured alone show no oscillation.
    """
    across, rho = residual[:, TANGENTIAL_AXIS], noise.reach_m
    S, Q = (np.bincount(noise.instant_index, weights=(rho * across) ** k) for k in (1, 2))
    R2, R4 = (np.bincount(noise.instant_index, weights=rho**k) for k in (2, 4))
    pairs = float((R2**2 - R4).sum())
    oscillation = float((S**2 - Q).sum()) / pairs if pairs > 0.0 else 0.0
    own = np.mean(residual**2, axis=0)
    own[TANGENTIAL_AXIS] -= max(oscillation, 0.0) * float(np.mean(rho**2))
    return own, oscillation
