"""The probability's numbers fitted on scored cases, checked on cases that they were not fitted on."""

from collections import Counter
from typing import Any

import numpy as np

from benchmarks.diagnosis.first_day.figures import Scores, reliability
from diagnosis.whole_model.probability import EVIDENCE_FEATURE_NAMES, fit_logistic, logistic
from machine.rotations import Array

PARTS = 5  # of the cases; each is judged by what the others gave


class TooFewError(Exception):
    """The scored cases hold no effects that are right, or none that are wrong."""


def calibrated(scores: Scores) -> dict[str, Any]:
    """What calibration.json holds: intercept and weights, what they were fitted on, and the curve of held-out cases.

    An effect is right when it, or an equal, is in the truth with its size; effects that are equal count once each.
    Raises: TooFewError: nothing to distinguish.
    """
    X, right, case = _table(scores)
    if len(set(right.tolist())) < 2:
        raise TooFewError(
            f"{len(right)} reported effects, {int(right.sum())} right: more cases are needed, of both sorts"
        )
    intercept, weights = fit_logistic(X, right)
    stated = _held_out(X, right, case)
    return {
        "intercept": round(intercept, 4),
        "weights": {
            name: round(float(weight), 4) for name, weight in zip(EVIDENCE_FEATURE_NAMES, weights, strict=True)
        },
        "fitted_on": f"{len(scores)} cases by `longreach bench first-day --calibrate`",
        "cases": len(scores),
        "effects": len(right),
        "right": int(right.sum()),
        "seeds": sorted({score.seed for score in scores}),
        "kinds": dict(sorted(Counter(score.kind for score in scores).items())),
        "nats_per_effect": round(_nats(stated, right), 4),
        "reliability": [
            {
                "stated": name,
                "effects": share.n,
                "mean_stated": round(mean, 4),
                "share_right": round(share.value, 4),
                "low": round(share.low, 4),
                "high": round(share.high, 4),
            }
            for name, mean, share in reliability(stated.tolist(), (right > 0.5).tolist())
        ],
    }


def _table(scores: Scores) -> tuple[Array, Array, Array]:
    """Figures (n, len(EVIDENCE_FEATURE_NAMES)), whether right (n,), and the number of the case (n,)."""
    rows = [(effect.figures, float(effect.right), k) for k, score in enumerate(scores) for effect in score.reported]
    X = np.array([figures for figures, _, _ in rows]).reshape(-1, len(EVIDENCE_FEATURE_NAMES))
    return X, np.array([right for _, right, _ in rows]), np.array([k for _, _, k in rows], dtype=float)


def _held_out(X: Array, right: Array, case: Array) -> Array:
    """Probability (n,) of each effect by numbers that were fitted on other cases."""
    out = np.full(len(right), float(right.mean()))
    for part in range(PARTS):
        own = case % PARTS == part
        if own.any() and len(set(right[~own].tolist())) == 2:
            intercept, weights = fit_logistic(X[~own], right[~own])
            out[own] = logistic(intercept + X[own] @ weights)
    return out


def _nats(stated: Array, right: Array) -> float:
    p = np.clip(np.where(right > 0.5, stated, 1.0 - stated), 1e-6, 1.0)
    return float(-np.log(p).mean())
