"""Probabilities fitted on a campaign that judges nothing: how sharp they are, what an effect costs, what is outside."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from benchmarks.diagnosis.gap.figures import Cases
from benchmarks.diagnosis.gap.reliability import Bin, share_of_first
from diagnosis.verdict.unseen import counted_as
from diagnosis.verdict.weigh import calibration
from machine.rotations import Array

Ladder = list[tuple[int, float, bool]]  # effects, probability among the catalogue's, whether it is the truth
HEADINGS = ("none", "effects", "sure", "undecided", "outside")
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


def fit(cases: Cases, keep_temperature: bool = False) -> Fitted:
    """Maximum likelihood of the truths; `keep_temperature` counts the shares only and leaves s = 1, d = 0.

    Model: p' ~ (p e^(-d k))^s over a case's hypotheses, k effects each; s and d over cases of the catalogue;
           P(outside | heading) by counting, half a case of each kind added; of the others P(unseen | heading), which
           is what makes the mean of what is stated the share that was right.
    Why not the share whose truth is not printed: a truth that was printed with a hundredth is as good as unseen.
    """
    inside = [_ladder(one) for one in cases if one["mix"] in INSIDE and one["ladder"]]

    def cost(x: Array) -> float:
        total = sum(-np.log(max(_right(ladder, np.exp(x[0]), x[1]), MISSING)) for ladder in inside)
        return float(total / max(len(inside), 1) + FADE * (x[0] ** 2 + 0.1 * x[1] ** 2))

    fitted = bool(inside) and not keep_temperature
    found = minimize(cost, np.zeros(2), method="Nelder-Mead").x if fitted else np.zeros(2)
    outside, unseen = ({word: share(cases, word) for word in HEADINGS} for share in (_outside, _unseen))
    return Fitted(float(np.exp(found[0])), float(found[1]), outside, unseen, len(cases))


def _ladder(one: dict[str, Any]) -> Ladder:
    return [(int(k), float(p), bool(right)) for k, p, right in one["ladder"]]


def _weighed(ladder: Ladder, sharper: float, per_effect: float) -> Array:
    """The hypotheses' probabilities (k,), had they been fitted so."""
    weights = np.array([max(p, 1e-12) ** sharper * np.exp(-sharper * per_effect * k) for k, p, _ in ladder])
    return weights / weights.sum()


def _right(ladder: Ladder, sharper: float, per_effect: float) -> float:
    return float(_weighed(ladder, sharper, per_effect)[[right for _, _, right in ladder]].sum())


def _outside(cases: Cases, word: str) -> float:
    said = [one["mix"] in ("foreign", "lacking") for one in cases if heading(one) == word]
    return round((sum(said) + 0.5) / (len(said) + 1.0), 4)


def _unseen(cases: Cases, word: str) -> float:
    """What has to be unseen for the first hypothesis (or its equals) to be right as often as stated on the average."""
    inside = [one for one in with_equals_known(cases) if one["mix"] in INSIDE and one["ladder"]]
    said = [one for one in inside if heading(one) == word]
    right = sum(any(one["ladder"][k][2] for k in one.get("equals", [0])) for one in said)
    stated = sum(share_of_first(one) for one in said)
    return round(max(1.0 - (right + 0.5) / (stated + 1.0), 0.0), 4)


def heading(one: dict[str, Any]) -> str:
    """Under which the diagnosis looks its shares up."""
    return counted_as(one["verdict"], share_of_first(one))


def with_equals_known(cases: Cases) -> list[dict[str, Any]]:
    """Without those of older packed scores that named what has equals, and do not say which hypotheses these are."""
    return [one for one in cases if "equals" in one or max(one["classes"], default=1) == 1]


def shares_of_today() -> Fitted:
    """What this tree's calibration.json says is outside or unseen, for answers of the same temperature."""
    now = calibration()
    return Fitted(1.0, 0.0, dict(now.outside_probability), dict(now.unseen_probability), 0)


def restated(cases: Cases, found: Fitted) -> list[dict[str, Any]]:
    """The cases with the probability that the first hypothesis would have been given, its equals beside it."""
    out = []
    for one in cases:
        ladder, word = _ladder(one), heading(one)
        p = [float(share) for share in _weighed(ladder, found.sharper, found.per_effect)] if ladder else []
        inside = (1.0 - found.outside[word]) * (1.0 - found.unseen[word])
        again = [[k, share, right] for (k, _, right), share in zip(ladder, p, strict=True)]
        out.append({**one, "ladder": again, "probability": p[0] * inside if p else 0.0})
    return out


def calibrated(text: str, found: Fitted, reliability: list[Bin], told: str) -> str:
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
