"""The noise floor of a signal from repeats of one command, and the filter that makes its increments white.

Increments of 20 Hz block means, since the open-loop error of an integrating plant is a random walk. The noise comes
from repeats, never from the residual of the model under test, which would hide the gap in it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.linalg import solve_toeplitz

from diagnosis.errors import DiagnosisError
from machine.rotations import Array

BLOCK_DURATION_S = 0.05
AR_ORDER_MAX = 6
REMAINDER_AR_ORDER = 20  # of what a baseline leaves: a second, in which a slow oscillation shows
SIGMA_EPSILON = 1e-12
IMPULSE_RESPONSE_LENGTH = 1000  # increments, 50 s
SAME_READING_TOLERANCE = 1e-9  # two readings closer than this are one [rad or m]
REPEATED_READINGS_MIN_FRAC = 0.2  # of a log's rows: a signal without steps hardly ever repeats itself
SMALLEST_CHANGE_RATIO_MIN = 0.6  # the least change over what one in ten stays below: without steps a tenth


@dataclass(frozen=True, slots=True)
class Whitener:
    """r_k = (d_k - sum_i a_i d_(k-i)) / sigma, per channel.

    `ar_coefficients`: a (p, n), row i for lag i + 1; `innovation_sigma`: sigma (n,).
    """

    ar_coefficients: Array
    innovation_sigma: Array

    @property
    def lag_count(self) -> int:
        """Lags used."""
        return len(self.ar_coefficients)

    def of_channels(self, channels: list[int]) -> "Whitener":
        """The filter of these channels, without lags that none of them uses: each costs 50 ms of every stretch."""
        a = np.ascontiguousarray(self.ar_coefficients[:, channels])
        used = np.nonzero(a.any(axis=1))[0]
        return Whitener(a[: used[-1] + 1 if len(used) else 0], self.innovation_sigma[channels])

    def whiten(self, increments: Array) -> Array:
        """White residuals (m - order, n) of increments (m, n)."""
        d = np.asarray(increments, dtype=float)
        p = self.lag_count
        if d.ndim != 2 or d.shape[1] != len(self.innovation_sigma) or len(d) <= p:
            raise DiagnosisError(
                f"increments have shape {d.shape}; give (m, {len(self.innovation_sigma)}) with m above {p}"
            )
        predicted = np.zeros_like(d[p:])
        for i in range(p):
            predicted += self.ar_coefficients[i] * d[p - 1 - i : len(d) - 1 - i]
        return (d[p:] - predicted) / self.innovation_sigma


@dataclass(frozen=True, slots=True)
class Floor:
    """Noise of one signal: `deviation_rms` (n,), `increment_rms` (n,), the whitener.

    `is_measured`: from repeats; else a bound from the signal's fastest part, to be said in the report.
    """

    deviation_rms: Array
    increment_rms: Array
    whitener: Whitener
    is_measured: bool


def block_means(values: Array, dt_s: float, block_s: float = BLOCK_DURATION_S) -> Array:
    """Means over blocks of 50 ms (m', n); a log slower than that is left as it is."""
    size = max(1, round(block_s / dt_s))
    rows = len(values) // size * size
    return np.asarray(values[:rows].reshape(-1, size, values.shape[1]).mean(axis=1))


def block_increments(values: Array, dt_s: float) -> Array:
    """Differences of 20 Hz block means (m' - 1, n)."""
    return np.diff(block_means(values, dt_s), axis=0)


def floor_of_repeats(repeats: Array, dt_s: float) -> Floor:
    """Noise from repeats of one command.

    Model:   deviations from the repeats' mean, times sqrt(R / (R - 1)); block means at 20 Hz; increments; AR(p) over
             all repeats, p of 0..6 by BIC, one order for all channels.
    Args:    repeats: (R, m, n), R 2 or more, finite; of a measured signal, or of the nominal model's residual in each.
    Raises:  DiagnosisError: fewer repeats, or too few rows.
    """
    values = np.asarray(repeats, dtype=float)
    if values.ndim != 3 or len(values) < 2 or not np.isfinite(values).all():
        raise DiagnosisError(f"repeats have shape {values.shape}; give finite (R, m, n) with R of 2 or more")
    scale = np.sqrt(len(values) / (len(values) - 1.0))
    deviations = (values - values.mean(axis=0)) * scale
    steps = [block_increments(deviation, dt_s) for deviation in deviations]
    if len(steps[0]) < 4 * AR_ORDER_MAX:
        raise DiagnosisError(
            f"repeats are {len(values[0]) * dt_s:.3g} s long; give {4.5 * AR_ORDER_MAX * BLOCK_DURATION_S:g} s or more"
        )
    whitener = fit_whitener(steps)
    rms = np.sqrt(np.mean(np.stack([block_means(deviation, dt_s) for deviation in deviations]) ** 2, axis=(0, 1)))
    return Floor(rms, np.sqrt(np.mean(np.stack(steps) ** 2, axis=(0, 1))), whitener, True)


def with_remainder(floor: Floor, steps: list[Array], ar: Array, sigma: Array, rms: Array) -> Floor:
    """A floor raised by what a baseline leaves of the model's form.

    Model: remainder and noise are independent, so that their autocovariances add; the filter is the autoregression of
           the sum (Yule-Walker). Either one's own filter would leave the other coloured, and coloured residuals make
           every test of them fire.
    Args:  steps: increments (m, n) of the repeats' deviations, none where nothing was repeated. ar: (p, n), zero in
           columns without autoregression. sigma, rms: (n,), 0 in columns without a remainder, which are left alone.
    """
    order = max(floor.whitener.lag_count, len(ar), AR_ORDER_MAX)
    a = np.zeros((order, len(sigma)))
    a[: floor.whitener.lag_count] = floor.whitener.ar_coefficients
    out = floor.whitener.innovation_sigma.copy()
    for j in np.nonzero(sigma > 0.0)[0]:
        quiet = (
            _sample_autocovariance([run[:, j] for run in steps], order)
            if steps
            else _white_autocovariance(float(out[j]), order)
        )
        a[:, j], out[j] = _yule_walker(_process_autocovariance(ar[:, j], float(sigma[j]), order) + quiet)
    raised = np.sqrt(floor.increment_rms**2 + rms**2)
    share = np.where(sigma > 0.0, 1.0, floor.deviation_rms)
    return replace(floor, deviation_rms=share, increment_rms=raised, whitener=Whitener(a, out))


def _process_autocovariance(ar: Array, sigma: float, order: int) -> Array:
    """Autocovariance (order + 1,) of an autoregression, by its response to one innovation."""
    response = _impulse_response(np.asarray(ar, dtype=float), IMPULSE_RESPONSE_LENGTH)
    if not np.isfinite(response).all() or abs(response[-1]) > 1e-3:  # on the edge of stability: as white
        return _white_autocovariance(sigma, order)
    return sigma**2 * np.array(
        [float(response[: IMPULSE_RESPONSE_LENGTH - k] @ response[k:]) for k in range(order + 1)]
    )


@njit(cache=True)
def _impulse_response(ar: Array, count: int) -> Array:
    """What follows one innovation of an autoregression (count,); scipy.signal takes two seconds to import."""
    out = np.zeros(count)
    out[0] = 1.0
    for i in range(1, count):
        for k in range(min(i, len(ar))):
            out[i] += ar[k] * out[i - 1 - k]
    return out


def _white_autocovariance(sigma: float, order: int) -> Array:
    return np.concatenate([[sigma**2], np.zeros(order)])


def _sample_autocovariance(runs: list[Array], order: int) -> Array:
    """Autocovariance (order + 1,) of runs without a mean; the biased one, which is always that of a process."""
    rows = sum(len(run) for run in runs)
    return np.array([sum(float(run[: len(run) - k] @ run[k:]) for run in runs) / rows for k in range(order + 1)])


def _yule_walker(covariance: Array) -> tuple[Array, float]:
    """Coefficients (order,) and innovation's sigma of the autoregression with an autocovariance (order + 1,)."""
    first = covariance[:-1] * np.concatenate([[1.0 + 1e-9], np.ones(len(covariance) - 2)])
    a = np.asarray(solve_toeplitz(first, covariance[1:]), dtype=float)
    return a, float(np.sqrt(max(covariance[0] - a @ covariance[1:], SIGMA_EPSILON**2)))


def encoder_step(column: Array) -> float:
    """The encoder's resolution [rad]: the step that most changes are multiples of; 0 where it shows none.

    Behind a linkage the same step of the encoder is a little longer here than there: then changes pile up at the least.
    """
    changes = np.abs(np.diff(column[np.isfinite(column)]))
    still = float(np.mean(changes <= SAME_READING_TOLERANCE)) if len(changes) else 0.0
    changes = changes[changes > SAME_READING_TOLERANCE]
    if len(changes) < 50:
        return 0.0
    least, step, more = np.quantile(changes, (0.01, 0.02, 0.1))
    away = np.abs(changes / step - np.round(changes / step))
    multiples = float(np.median(away)) < 0.02
    return (
        float(step)
        if multiples or (still > REPEATED_READINGS_MIN_FRAC and least > SMALLEST_CHANGE_RATIO_MIN * more)
        else 0.0
    )


def repeat_deviations(repeats: Array) -> list[Array]:
    """Each repeat less their mean, at the noise's own size, of repeats (R, m, n)."""
    scale = np.sqrt(len(repeats) / (len(repeats) - 1.0))
    return list((repeats - repeats.mean(axis=0)) * scale)


def floor_without_repeats(signal: Array, dt_s: float) -> Floor:
    """A stand-in where nothing was repeated: the part of the signal that a smooth motion cannot hold.

    Model: increments' second differences over sqrt(6), robustly by their median: right for white increments (a random
           walk), 1.3 times too large for white noise of the signal itself; never too low for either.
    """
    d = block_increments(np.asarray(signal, dtype=float), dt_s)
    if len(d) < 4:
        raise DiagnosisError(f"the signal has {len(d)} increments at 20 Hz; give at least a second of data")
    sigma = np.maximum(np.median(np.abs(np.diff(d, n=2, axis=0)), axis=0) / 0.6745 / np.sqrt(6.0), SIGMA_EPSILON)
    return Floor(sigma / np.sqrt(2.0), sigma, Whitener(np.zeros((0, d.shape[1])), sigma), False)


def fit_whitener(runs: list[Array]) -> Whitener:
    """AR(p) by least squares over several runs of increments (m, n) each; no mean, p by BIC over all channels."""
    best, best_score = None, np.inf
    for p in range(AR_ORDER_MAX + 1):
        a, sigma, count = _fit_autoregression(runs, p)
        score = float(np.sum(2.0 * count * np.log(np.maximum(sigma, SIGMA_EPSILON)))) + p * a.shape[1] * np.log(count)
        if score < best_score:
            best, best_score = Whitener(a, np.maximum(sigma, SIGMA_EPSILON)), score
    if best is None:
        raise DiagnosisError("increments are not finite; fix the signal first")
    return best


def _fit_autoregression(runs: list[Array], p: int) -> tuple[Array, Array, int]:
    """Coefficients (p, n), innovation's sigma (n,), rows used; every order uses the same rows."""
    n = runs[0].shape[1]
    a, sigma = np.zeros((p, n)), np.zeros(n)
    count = sum(len(run) - AR_ORDER_MAX for run in runs)
    for j in range(n):
        y = np.concatenate([run[AR_ORDER_MAX:, j] for run in runs])
        lags = [np.concatenate([run[AR_ORDER_MAX - i : len(run) - i, j] for run in runs]) for i in range(1, p + 1)]
        if p:
            X = np.stack(lags, axis=1)
            a[:, j] = np.linalg.lstsq(X, y, rcond=None)[0]
            y = y - X @ a[:, j]
        sigma[j] = np.sqrt(np.mean(y**2))
    return a, sigma, count
