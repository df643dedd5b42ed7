"""From the evidence of an effect to the probability that it is there with that size: one trained, monotone model.

Model:  logistic regression with coefficients of known sign on a few figures of the evidence (`features`). The numbers
        are in calibration.json, with the cases they were fitted on and the reliability curve; a command makes them anew
        (docs/diagnosis.md). Nothing else in the diagnosis is a threshold on evidence.
"""

import json
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from diagnosis.whole_model.evidence import Evidence
from machine.rotations import Array

#: Figures of the evidence, each the better the larger.
FEATURES = ("gain", "size", "invariance", "remainder", "noise_known")
CAP = 1e3


def features(evidence: Evidence) -> Array:
    """The figures (FEATURES,) of one effect's evidence."""
    p = max(evidence.invariance_p, 1e-300)
    return np.array(
        [
            np.log1p(np.clip(evidence.gain_nats, 0.0, CAP)),
            np.log1p(min(evidence.z, CAP)),
            -np.log1p(-np.log(p)),
            -np.log(max(evidence.left, 1.0)),
            float(evidence.noise_known),
        ]
    )


def probability(evidence: Evidence) -> float:
    """Probability that the effect is there with this size, equals counted as it."""
    table = calibration()
    score = float(table["intercept"]) + float(np.dot(table["weights"], features(evidence)))
    return float(1.0 / (1.0 + np.exp(-score)))


@cache
def calibration() -> dict[str, Any]:
    """The trained numbers: intercept, weights, and what they were fitted on."""
    text = files("diagnosis.whole_model").joinpath("calibration.json").read_text(encoding="utf-8")
    return json.loads(text)


def fitted(X: Array, right: Array, penalty: float = 1e-2, rounds: int = 4000) -> tuple[float, Array]:
    """Intercept and weights, none below zero, that make `right` (n,) most likely from features X (n, k).

    Model: maximum likelihood with a small ridge, by projected gradient; the problem is convex.
    """
    n, k = X.shape
    centre, scale = X.mean(axis=0), np.maximum(X.std(axis=0), 1e-9)
    Z = np.concatenate([np.ones((n, 1)), (X - centre) / scale], axis=1)
    w = np.zeros(k + 1)
    step = 4.0 / float(np.linalg.eigvalsh(Z.T @ Z / n).max())
    for _ in range(rounds):
        p = 1.0 / (1.0 + np.exp(-(Z @ w)))
        w -= step * (Z.T @ (p - right) / n + penalty * np.concatenate([[0.0], w[1:]]) / n)
        w[1:] = np.maximum(w[1:], 0.0)
    weights = w[1:] / scale
    return float(w[0] - weights @ centre), weights
