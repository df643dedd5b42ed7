"""From the evidence of an effect to the probability that it is there with that size: one trained, monotone model.

Model:  logistic regression with coefficients of known sign on a few figures of the evidence (`evidence_features`).
        The numbers are in calibration.json, with the cases they were fitted on and the reliability curve;
        `longreach bench first-day --calibrate` fits them (docs/first-day.md). Nothing else in the
        diagnosis is a threshold on evidence.
"""

import json
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.optimize import minimize

from diagnosis.whole_model.evidence import DETECTION_LIMIT_SIGMAS, Evidence
from machine.rotations import Array

#: Figures of the evidence, each the better the larger.
EVIDENCE_FEATURE_NAMES = ("gain", "size", "alone", "detectable", "agreement", "remainder", "noise_known")
CONFIRMED_PROBABILITY = 0.9  # probability from which an effect is confirmed; below a half nothing is "found"
LIKELY_PROBABILITY = 0.5
FEATURE_VALUE_MAX = 1e3
SIZE_AGREEMENT_FRAC = 0.01  # a size that is the same to a hundredth is the same
EXPLAINED_FRAC_FLOOR = 1e-4  # of what is left: below, an effect is lost in it
RIDGE_PENALTY = 2.5**-2.0


def evidence_features(evidence: Evidence) -> Array:
    """The figures (len(EVIDENCE_FEATURE_NAMES),) of one effect's evidence.

    Why a size over its deviation is at most the root of twice the gain: the deviation of a shape or a threshold may be
    far too small (Hauck, Donner 1977); the likelihood ratio is not misled by it.
    """
    z = min(evidence.size_z_score, float(np.sqrt(2.0 * max(evidence.gain_nats, 0.0))))
    return np.array(
        [
            np.log1p(np.clip(evidence.gain_nats, 0.0, FEATURE_VALUE_MAX)),
            np.log1p(min(z, FEATURE_VALUE_MAX)),
            np.log1p(min(evidence.full_model_z_score, FEATURE_VALUE_MAX)),
            min(z / DETECTION_LIMIT_SIGMAS, 1.0),
            -np.log(SIZE_AGREEMENT_FRAC + min(evidence.size_scatter_frac, 1.0)),
            np.log(max(evidence.explained_frac, EXPLAINED_FRAC_FLOOR)),
            float(evidence.noise_known),
        ]
    )


def probability(evidence: Evidence) -> float:
    """Probability that the effect is there with this size, equals counted as it.

    With a baseline the noise, what the machine's usual state leaves, and the prior odds are known: then the posterior
    odds are those of the gain, with what the size scatters by taken as part of its deviation. Without a baseline they
    are not, and the calibration takes their place.
    """
    if evidence.prior_nats is not None:
        share = (
            1.0
            if np.isinf(evidence.size_z_score)
            else 1.0 / (1.0 + (evidence.size_scatter_frac * evidence.size_z_score) ** 2)
        )
        return float(logistic(evidence.prior_nats + share * (evidence.gain_nats - evidence.prior_nats)))
    return probability_of(evidence_features(evidence))


def probability_of(figures: Array) -> float:
    """The same from the figures (len(EVIDENCE_FEATURE_NAMES),) of its evidence."""
    table = trained_calibration()
    weights = [
        float(table["weights"].get(name, 0.0)) for name in EVIDENCE_FEATURE_NAMES
    ]  # 0: a figure that is newer than the fit
    return float(logistic(float(table["intercept"]) + figures @ np.array(weights)))


def logistic(score: Array | float) -> Array:
    """1 / (1 + e^-score), without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * np.asarray(score))), dtype=float)


@cache
def trained_calibration() -> dict[str, Any]:
    """The trained numbers: intercept, weights, and what they were fitted on."""
    text = files("diagnosis.whole_model").joinpath("calibration.json").read_text(encoding="utf-8")
    return json.loads(text)


def fit_logistic(X: Array, right: Array, penalty: float = RIDGE_PENALTY) -> tuple[float, Array]:
    """Intercept and weights, none below zero, that make `right` (n,) most likely from figures X (n, k).

    Model:  logistic regression, figures standardised, w_j ~ N(0, 1 / penalty): finite where the data are separable.
    Source: Gelman, Jakulin, Pittau, Su 2008 (weakly informative scale 2.5).
    """
    centre, scale = X.mean(axis=0), X.std(axis=0)
    scale = np.where(scale > 1e-9, scale, np.inf)  # a figure that never varies says nothing
    Z = np.concatenate([np.ones((len(X), 1)), (X - centre) / scale], axis=1)
    sign = 2.0 * right - 1.0

    def cost(w: Array) -> tuple[float, Array]:
        margin = sign * (Z @ w)
        ridge = np.concatenate([[0.0], penalty * w[1:]])
        return float(np.logaddexp(0.0, -margin).sum() + 0.5 * ridge @ w), ridge - Z.T @ (sign * logistic(-margin))

    bounds = [(None, None), *[(0.0, None)] * X.shape[1]]
    w = minimize(cost, np.zeros(Z.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-12}).x
    weights = w[1:] / scale
    return float(w[0] - weights @ centre), weights
