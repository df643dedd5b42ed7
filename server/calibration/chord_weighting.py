"""Chords of every length at once, each weighted as the odometry's drift and jitter ask: generalised least squares."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from server.calibration.contracts import Array


@dataclass(frozen=True, slots=True)
class ChordWeighting:
    """The information matrix P of one axis of a track's positions, without forming it.

    `own` (n,): W's diagonal [1/m^2]; `factor` (2, n): banded Cholesky factor of T; `spread` (n,): T^-1's
    diagonal [m^2], the variance of the smoothed position; `log_det`: log of the product of P's eigenvalues but the zero
    one, up to a constant that depends on the arc lengths only.
    """

    own: Array
    factor: Array
    spread: Array
    log_det: float

    def times(self, values: Array) -> Array:
        """P @ values, shape (n, k)."""
        return self.own[:, None] * (values - self.smoothed(values))

    def smoothed(self, values: Array) -> Array:
        """What of the values (n, k) the drift takes up: T^-1 W values."""
        return cho_solve_banded((self.factor, True), self.own[:, None] * values, check_finite=False)

    def left_out(self, values: Array) -> tuple[Array, Array]:
        """Each sample against what all others say of it.

        Returns: differences (n, k) [m] and the one-axis variance (n,) [m^2] of what the others say.
        """
        lever = np.maximum(1.0 - self.own * self.spread, 1e-9)
        return (values - self.smoothed(values)) / lever[:, None], self.spread / lever


def chord_weighting(arc_steps_m: Array, drift: float, jitter: float, weights: Array) -> ChordWeighting:
    """Weights of all chords of a track whose error is a random walk over the arc length plus white jitter.

    Model:   position error e_i = d_i + n_i, var n = jitter, var (d_i+1 - d_i) = drift ds_i, start unknown. Information
             of one axis with d and the start taken out: P = W - W T^-1 W, T = W + D^T diag(1 / drift ds) D,
             W = weights / jitter. P 1 = 0, so y^T P x = -1/2 sum_ij P_ij (y_i - y_j)(x_i - x_j): chords of every
             length take part. Little drift: all pairs alike (Kabsch); much drift: single steps.
    Args:    arc_steps_m (n-1,): path length between samples [m]; drift [m^2/m] > 0; jitter [m^2] > 0; weights (n,),
             0..1: each sample's jitter is jitter / weight, so 0 leaves it out.
    Returns: the weighting; O(n) to make and to apply.
    Source:  generalised least squares (Aitken 1936) on a local level model (Harvey 1989).
    """
    steps = np.maximum(arc_steps_m, 1e-3 * max(float(np.mean(arc_steps_m)), 1e-9))  # at rest it drifts next to nothing
    links = 1.0 / (drift * steps)
    own = np.maximum(weights, 1e-9) / jitter
    T = np.zeros((2, len(own)))
    T[0] = own
    T[0, :-1] += links
    T[0, 1:] += links
    T[1, :-1] = -links
    factor = cholesky_banded(T, lower=True, check_finite=False)
    forward = factor[0] ** 2
    log_det = float(np.sum(np.log(own)) + np.sum(np.log(links)) - np.sum(np.log(forward)))
    return ChordWeighting(own=own, factor=factor, spread=_inverse_diagonal(T, forward), log_det=log_det)


def _inverse_diagonal(T: Array, forward: Array) -> Array:
    """Diagonal of a tridiagonal matrix's inverse from the pivots of both directions (Meurant 1992)."""
    turned = np.zeros_like(T)
    turned[0] = T[0, ::-1]
    turned[1, :-1] = T[1, :-1][::-1]
    backward = cholesky_banded(turned, lower=True, check_finite=False)[0][::-1] ** 2
    return 1.0 / (forward + backward - T[0])
