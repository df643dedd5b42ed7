"""Probabilities fitted on a campaign that judges nothing: how sharp they are, what an effect costs, what is outside."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from machine.rotations import Array

Cases = Sequence[dict[str, Any]]
Ladder = list[tuple[int, float, bool]]  # effects, probability among the catalogue's, whether it is the truth
WORDS = ("none", "effects", "undecided", "outside")
INSIDE = ("none", "single", "double")  # kinds of cases that the catalogue explains
MISSING = 1e-3  # of the truth where none of the hypotheses that were printed is it
FADE = 0.02  # prior on the two numbers: few cases must not sharpen anything


@dataclass(frozen=True, slots=True)
class Fitted:
    """`sharper`: exponent on every probability; `per_effect`: nats that each effect costs beyond what it did."""

    sharper: float
    per_effect: float
    outside: dict[str, float]
    unseen: dict[str, float]
    cases: int


def fit(cases: Cases) -> Fitted:
    """Maximum likelihood of the truths.

    Model: p' ~ (p e^(-d k))^s over a case's hypotheses, k effects each; s and d over cases of the catalogue;
           P(outside | verdict), and of the others P(truth not among the hypotheses | verdict), by counting, half a
           case of each kind added.
    """
    inside = [_ladder(one) for one in cases if one["mix"] in INSIDE and one["ladder"]]

    def cost(x: Array) -> float:
        total = sum(-np.log(max(_right(ladder, np.exp(x[0]), x[1]), MISSING)) for ladder in inside)
        return float(total / max(len(inside), 1) + FADE * (x[0] ** 2 + 0.1 * x[1] ** 2))

    found = minimize(cost, np.zeros(2), method="Nelder-Mead").x if inside else np.zeros(2)
    outside, unseen = ({word: share(cases, word) for word in WORDS} for share in (_outside, _unseen))
    return Fitted(float(np.exp(found[0])), float(found[1]), outside, unseen, len(cases))


def _ladder(one: dict[str, Any]) -> Ladder:
    return [(int(k), float(p), bool(right)) for k, p, right in one["ladder"]]


def _right(ladder: Ladder, sharper: float, per_effect: float) -> float:
    weights = np.array([max(p, 1e-12) ** sharper * np.exp(-sharper * per_effect * k) for k, p, _ in ladder])
    return float(weights[[right for _, _, right in ladder]].sum() / weights.sum())


def _outside(cases: Cases, word: str) -> float:
    said = [one["mix"] in ("foreign", "lacking") for one in cases if one["verdict"] == word]
    return round((sum(said) + 0.5) / (len(said) + 1.0), 4)


def _unseen(cases: Cases, word: str) -> float:
    said = [one for one in cases if one["verdict"] == word and one["mix"] in INSIDE and one["ladder"]]
    missing = [not any(right for _, _, right in one["ladder"]) for one in said]
    return round((sum(missing) + 0.5) / (len(said) + 1.0), 4)


def restated(cases: Cases, found: Fitted) -> list[dict[str, Any]]:
    """The cases with the probability that the first hypothesis would have been given."""
    out = []
    for one in cases:
        ladder, word = _ladder(one), one["verdict"]
        weights = [max(p, 1e-12) ** found.sharper * np.exp(-found.sharper * found.per_effect * k) for k, p, _ in ladder]
        share = float(weights[0] / np.sum(weights)) if ladder else 0.0
        out.append({**one, "probability": share * (1.0 - found.outside[word]) * (1.0 - found.unseen[word])})
    return out


def calibrated(text: str, found: Fitted, reliability: list[tuple[str, int, float, float]], told: str) -> str:
    """The package's calibration.json (as `text`) with the fitted numbers and the curve they were checked by."""
    data = json.loads(text)
    T = float(data["temperature"])
    data["temperature"] = round(T / found.sharper, 4)
    data["temperature_without_floor"] = round(max(data["temperature_without_floor"], 3.0 * data["temperature"]), 4)
    data["penalty_nats_per_effect"] = round(data["penalty_nats_per_effect"] + T * found.per_effect, 4)
    data["outside_probability"], data["unseen_probability"] = found.outside, found.unseen
    data["fitted_on"] = told
    data["note"] = "frozen numbers of the probabilities, by `longreach bench gap --calibrate`"
    data["reliability"] = [
        {"stated": name, "cases": count, "mean_stated": round(mean, 4), "share_right": round(share, 4)}
        for name, count, mean, share in reliability
    ]
    return json.dumps(data, indent=2) + "\n"
