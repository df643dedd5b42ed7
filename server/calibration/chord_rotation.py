"""Rotation, scale and clock offset together, from all chords jointly; the noise levels come from the data itself."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from machine.rotations import rotation_from_rotvec
from server.calibration.contracts import Array
from server.calibration.rotation_fit import robust_sigma

#: Drift variance over one metre to jitter variance: from "no drift" to "no jitter", three values in two decades.
_RATIOS = 10.0 ** np.linspace(-3.0, 6.0, 14)
#: Sizes of a linear non-rigid part (strain, one entry). The first is negligible, and as likely as all others together,
#: which share by Student's t (3 degrees of freedom, scale 0.5 %: lengths, zeros and sag of such a crane).
_STRAINS = np.array([1e-4, 0.005, 0.01, 0.02, 0.04, 0.08])
_STRAIN_SHARES = _STRAINS * (1.0 + _STRAINS**2 / (3.0 * 0.005**2)) ** -2
_STRAIN_LOG_PRIOR = np.log(np.concatenate(([0.5], 0.5 * _STRAIN_SHARES[1:] / _STRAIN_SHARES[1:].sum())))
_JITTER_FLOOR_M2 = 1e-6**2
_SHAKING_M = 0.01  # rms extent of a path: where it has less it is shaking, and a strain of 2 % below the jitter
_N_MOTION = 5  # rotation vector, log scale, clock offset; nine entries of the strain follow
_OFFSET = 4
#: e_b x q = _EPSILON[a, b, c] q_c, component a.
_EPSILON = np.array(
    [[[0, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 0, 0], [1, 0, 0]], [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]]
)


@dataclass(frozen=True, slots=True)
class ChordWeighting:
    """The information matrix P of one axis of a track's positions, without forming it.

    `weight_diagonal` (n,): W's [1/m^2]; `cholesky_factor` (2, n): of T, banded; `smoothed_variance` (n,): T^-1's
    diagonal [m^2], the variance of the smoothed position; `log_det`: log of the product of P's eigenvalues but the zero
    one, up to a constant that depends on the arc lengths only.
    """

    weight_diagonal: Array
    cholesky_factor: Array
    smoothed_variance: Array
    log_det: float

    def project_values(self, values: Array) -> Array:
        """P @ values, shape (n, k)."""
        return self.weight_diagonal[:, None] * (values - self.drift_component(values))

    def drift_component(self, values: Array) -> Array:
        """What of the values (n, k) the drift takes up: T^-1 W values."""
        return cho_solve_banded(
            (self.cholesky_factor, True), self.weight_diagonal[:, None] * values, check_finite=False
        )

    def left_out(self, values: Array) -> tuple[Array, Array]:
        """Each sample against what all others say of it.

        Returns: differences (n, k) [m] and the one-axis variance (n,) [m^2] of what the others say.
        """
        lever = np.maximum(1.0 - self.weight_diagonal * self.smoothed_variance, 1e-9)
        return (values - self.drift_component(values)) / lever[:, None], self.smoothed_variance / lever


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
    return ChordWeighting(
        weight_diagonal=own, cholesky_factor=factor, smoothed_variance=_inverse_diagonal(T, forward), log_det=log_det
    )


def _inverse_diagonal(T: Array, forward: Array) -> Array:
    """Diagonal of a tridiagonal matrix's inverse from the pivots of both directions (Meurant 1992)."""
    turned = np.zeros_like(T)
    turned[0] = T[0, ::-1]
    turned[1, :-1] = T[1, :-1][::-1]
    backward = cholesky_banded(turned, lower=True, check_finite=False)[0][::-1] ** 2
    return 1.0 / (forward + backward - T[0])


@dataclass(frozen=True, slots=True)
class PairedTracks:
    """Base points and velocities at the camera's times, the odometry turned into the base, all (n, 3) [m], [m/s]."""

    base_points: Array
    base_velocities: Array
    rotated_vo_points: Array
    arc_steps_m: Array  # (n-1,)
    inliers: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ChordStep:
    """Change of (rotation vector, log scale, offset), its covariance (5, 5), the likeliest noise and its weighting."""

    parameter_step: Array
    covariance: Array
    drift_variance: float
    jitter_variance: float
    weighting: ChordWeighting


def _axis_design_matrix(axis: int) -> Array:
    """How the parameters enter one axis' residual, as columns over (point q, velocity v, residual r): (9, 14).

    Model:   r = y - s R x; a rotation vector w takes w x q from it, log s takes q, the offset -v, a strain M takes M q.
    """
    K = np.zeros((9, _N_MOTION + 9))
    K[:3, :3] = _EPSILON[axis].T
    K[axis, 3] = 1.0
    K[3 + axis, _OFFSET] = -1.0
    K[:3, _N_MOTION + 3 * axis : _N_MOTION + 3 * axis + 3] = np.eye(3)
    return K


_DESIGNS = tuple(_axis_design_matrix(axis) for axis in range(3))


def chord_step(tracks: PairedTracks, offset_s: float, offset_sigma_s: float) -> ChordStep:
    """The step, and the covariance after it, as a mixture over noise ratios and sizes of strain.

    Model:   r = A d + drift walk + jitter; d = (rotation, log s, offset, strain), strain ~ N(0, size^2 I), the offset
             known beforehand to `offset_sigma_s` about 0; each (ratio, size) weighs by its restricted likelihood. The
             strain stands for what is not rigid between the tracks (bending, wrong lengths): where it shears it must be
             expected to turn, which no residual shows; so the rotation's covariance grows with what the strain shows.
             Both count where the path extends only: across a flat one there is nothing but shaking, and odometry errs
             along with that, which on 2 mm passes for a turn or strain of 0.3.
    Source:  restricted likelihood: Patterson, Thompson 1971; averaging: Hoeting et al. 1999.
    """
    residuals = tracks.base_points - tracks.rotated_vo_points
    # the clean points stand for the rotated ones in the derivatives: the odometry's jitter must not explain itself
    points, residuals = tracks.base_points - tracks.base_points.mean(axis=0), residuals - residuals.mean(axis=0)
    columns = (_damp_weak_directions(points), tracks.base_velocities, residuals)
    stacked, weights = np.hstack(columns), tracks.inliers.astype(float)
    count = 3.0 * (float(tracks.inliers.sum()) - 1.0)
    found = []
    for ratio in _RATIOS:
        weighting = chord_weighting(tracks.arc_steps_m, float(ratio), 1.0, weights)
        found.append(_at_ratio(stacked, weighting, float(ratio), count, (offset_s, offset_sigma_s)))
    likelihoods, changes, covariances, jitters = (np.concatenate(each) for each in zip(*found, strict=True))
    shares = np.exp(likelihoods - likelihoods.max())
    shares /= shares.sum()
    change = shares @ changes
    apart = changes - change
    covariance = np.einsum("r,rij->ij", shares, covariances) + (apart * shares[:, None]).T @ apart
    best = int(np.argmax(shares))
    jitter = float(jitters[best])
    drift = float(_RATIOS[best // len(_STRAINS)] * jitter)
    return ChordStep(change, covariance, drift, jitter, chord_weighting(tracks.arc_steps_m, drift, jitter, weights))


def _damp_weak_directions(points: Array) -> Array:
    """Centred points (n, 3) less what lies in directions of hardly any extent: C (C + shaking^2)^-1 q, C = scatter."""
    scatter = points.T @ points / len(points)
    return points @ np.linalg.solve(scatter + _SHAKING_M**2 * np.eye(3), scatter)


def _at_ratio(
    stacked: Array, weighting: ChordWeighting, ratio: float, count: float, offset: tuple[float, float]
) -> tuple[Array, Array, Array, Array]:
    """Log likelihood, step, covariance and jitter at one drift-to-jitter ratio, for every size of strain."""
    gram = stacked.T @ weighting.project_values(stacked)
    N = np.sum([K.T @ gram @ K for K in _DESIGNS], axis=0)
    g = np.sum([K.T @ gram[:, 6 + axis] for axis, K in enumerate(_DESIGNS)], axis=0)
    square = float(np.trace(gram[6:, 6:]))
    free, _, rank, _ = np.linalg.lstsq(N, g, rcond=1e-9)
    jitter = max((square - float(g @ free)) / (count - rank), _JITTER_FLOOR_M2 / (1.0 + ratio))
    known = np.zeros((len(_STRAINS), len(g)))
    known[:, _OFFSET] = 1.0 / offset[1] ** 2
    known[:, _N_MOTION:] = 1.0 / _STRAINS[:, None] ** 2
    information = N / jitter + known[:, :, None] * np.eye(len(g))
    covariances = np.linalg.inv(information)
    pull = np.tile(g / jitter, (len(_STRAINS), 1))
    pull[:, _OFFSET] -= known[:, _OFFSET] * offset[0]
    changes = np.einsum("sij,sj->si", covariances, pull)
    misfit = square / jitter - np.einsum("si,si->s", changes, pull)
    volume = np.linalg.slogdet(information)[1] + 18.0 * np.log(_STRAINS)
    likelihoods = 1.5 * weighting.log_det - 0.5 * (count * np.log(jitter) + misfit + volume) + _STRAIN_LOG_PRIOR
    motion = slice(0, _N_MOTION)
    return likelihoods, changes[:, motion], covariances[:, motion, motion], np.full(len(_STRAINS), jitter)


#: Base track at the camera's times plus an offset [s]: positions (n, 3) [m] and velocities (n, 3) [m/s].
BaseTrack = Callable[[float], tuple[Array, Array]]

_JUMP_SIGMAS = 6.0
_SCALE_STEP_MAX = 0.2
_STEP_SMALL_SIGMAS = 0.01
_STEP_SMALL = 1e-5  # rad, log scale and s: less shows nowhere, though tracks without noise know better
OSCILLATION_FRAC = 0.5  # share of a step that the next one takes back
_FREE_ROUNDS = 8  # in which samples may come and go


@dataclass(frozen=True, slots=True)
class ChordRotation:
    """v_base ~ scale R_base_vo v_vo at camera time + offset; `covariance` (5, 5) of rotation vector [rad, left, base
    axes], log scale and offset [s]; `inliers` (n,); `drift_variance` [m^2/m], `jitter_variance` [m^2].
    """

    R_base_vo: Array
    scale: float
    offset_s: float
    covariance: Array
    inliers: NDArray[np.bool_]
    drift_variance: float
    jitter_variance: float
    converged: bool


@dataclass(frozen=True, slots=True)
class _Guess:
    R_base_vo: Array
    scale: float
    offset_s: float

    def after(self, change: Array, bound_s: float) -> "_Guess":
        return _Guess(
            rotation_from_rotvec(change[:3]) @ self.R_base_vo,
            self.scale * float(np.exp(np.clip(change[3], -_SCALE_STEP_MAX, _SCALE_STEP_MAX))),
            float(np.clip(self.offset_s + change[4], -bound_s, bound_s)),
        )


def fit_chord_rotation(
    points_vo: Array,
    base_track: BaseTrack,
    arc_steps_m: Array,
    R_start: Array,
    offset_start_s: float,
    offset_bound_s: float,
    iterations_max: int = 24,
) -> ChordRotation:
    """Rotation, scale and clock offset that fit both tracks best under drift and jitter of unknown size.

    Model:   y(t + tau) = s R x + c + d + n, d a random walk over the arc length, n white: least squares with the
             information P of `chord_weighting`; Gauss-Newton over (rotation, log s, tau); the noise by restricted
             likelihood, averaged over its posterior (`chord_step`); a sample is left out while it is likelier an
             outlier (uniform over the path's volume) than not, judged by what all others say of it.
    Args:    points_vo (n, 3): odometry [m]; base_track: the same points by kinematics; arc_steps_m (n-1,) [m]; R_start,
             offset_start_s: coarse start; offset_bound_s: largest offset, also its sd beforehand [s].
    Returns: the fit; not `converged` when the step still moves after `iterations_max`.
    Source:  Aitken 1936; Umeyama 1991 is the case without drift, offset and outliers.
    """
    guess = _Guess(R_start, 1.0, offset_start_s)
    points, velocities = base_track(guess.offset_s)
    kept = _not_jumping(points - points_vo @ R_start.T)
    tries, last = 0, np.zeros(5)
    while True:
        tries += 1
        tracks = PairedTracks(points, velocities, guess.scale * points_vo @ guess.R_base_vo.T, arc_steps_m, kept)
        step = chord_step(tracks, guess.offset_s, offset_bound_s)
        sigmas = np.sqrt(np.diag(step.covariance))
        change, last = _damp_oscillating_step(step.parameter_step, last, sigmas)
        guess = guess.after(change, offset_bound_s)
        points, velocities = base_track(guess.offset_s)
        before, kept = kept, _likely_inliers(points, guess.scale * points_vo @ guess.R_base_vo.T, step, kept)
        if tries > _FREE_ROUNDS and (before & kept).sum() >= 0.5 * len(kept):
            kept = before & kept  # who is still coming and going stays out: the choice cannot go round in circles
        small = np.abs(step.parameter_step) < _STEP_SMALL_SIGMAS * sigmas + _STEP_SMALL
        settled = bool(small.all()) and np.array_equal(before, kept)
        if settled or tries >= iterations_max:
            return ChordRotation(
                R_base_vo=guess.R_base_vo,
                scale=guess.scale,
                offset_s=guess.offset_s,
                covariance=step.covariance,
                inliers=kept,
                drift_variance=step.drift_variance,
                jitter_variance=step.jitter_variance,
                converged=settled,
            )


def _damp_oscillating_step(change: Array, last: Array, sigmas: Array) -> tuple[Array, Array]:
    """The step, halved where it takes back most of the one before; and itself in sigmas, for the next one.

    Velocities at a swinging boom change with the offset, so full steps in the offset can go to and fro for long.
    """
    wide = change / sigmas
    to_and_fro = float(wide @ last) < -OSCILLATION_FRAC * float(last @ last)
    return (0.5 * change, 0.5 * wide) if to_and_fro else (change, wide)


def _not_jumping(residuals: Array) -> NDArray[np.bool_]:
    """Samples that do not stand out from the median of the five about them."""
    padded = np.concatenate((residuals[1:3][::-1], residuals, residuals[-3:-1][::-1]))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    jumps = residuals - np.median(windows, axis=-1)
    calm = np.linalg.norm(jumps, axis=1) < _JUMP_SIGMAS * max(robust_sigma(jumps), 1e-6)
    return calm if calm.sum() >= 0.5 * len(calm) else np.ones(len(residuals), dtype=bool)


def _likely_inliers(points: Array, rotated: Array, step: ChordStep, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples that are likelier part of the track than spread over the path's volume; the old ones if few are."""
    differences, variances = step.weighting.left_out(points - rotated)
    total = variances + step.jitter_variance
    outlier_frac = float(np.clip(1.0 - kept.mean(), 0.01, 0.5))
    volume = float(np.ptp(points, axis=0).max()) ** 3
    exponents = np.sum(differences**2, axis=1) / (2.0 * total)
    likely = np.log1p(-outlier_frac) - 1.5 * np.log(2.0 * np.pi * total) - exponents > np.log(outlier_frac / volume)
    return likely if likely.sum() >= 0.5 * len(likely) else kept
