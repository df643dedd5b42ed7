"""A case's answer against its truth: which reported effects are there, which true ones were found, sizes, shares."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.diagnosis.first_day.runner import Scored
from diagnosis.whole_model.probability import (
    CONFIRMED_PROBABILITY,
    EVIDENCE_FEATURE_NAMES,
    LIKELY_PROBABILITY,
    probability_of,
)
from machine.rotations import Array

WIDER = 2.0  # a size is right within this many half widths of its 90 % limits, or within CLOSE of the truth
CLOSE = 0.1
Entry = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Reported:
    """One reported effect: its figures, probability by this tree's calibration, and what the truth says of it.

    `there`: it, or one of its equals, is in the truth. `right`: and its size is right. `inside`: whether its 90 %
    limits hold the true size, None where the truth holds an equal, or nothing. `share`, `true_share`: of the squared
    millimetres of all.
    """

    name: str
    joint: int | None
    figures: Array
    probability: float
    mm: float
    there: bool
    by_equal: bool
    right: bool
    inside: bool | None
    share: float
    true_share: float | None

    @property
    def confirmed(self) -> bool:
        """Whether the answer counts on it."""
        return self.probability >= CONFIRMED_PROBABILITY

    @property
    def likely(self) -> bool:
        """Whether it is more likely there than not."""
        return self.probability >= LIKELY_PROBABILITY


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """One true effect of the catalogue: its millimetres at the tip and as seen, and whether it was confirmed."""

    name: str
    joint: int | None
    tip_mm: float
    seen_mm: float
    found: bool


@dataclass(frozen=True, slots=True)
class Score:
    """One case."""

    kind: str
    seed: int
    number: int
    seconds: float
    verdict: str
    reported: tuple[Reported, ...]
    true: tuple[TrueEffect, ...]
    miss_mm: float | None
    left_mm: float | None

    def coverage(self, seen: bool) -> float | None:
        """Share of the true effects' squared millimetres that confirmed effects cover; None where there are none."""
        squares = np.array([(effect.seen_mm if seen else effect.tip_mm) ** 2 for effect in self.true])
        found = np.array([effect.found for effect in self.true], dtype=bool)
        total = float(squares.sum())
        return float(squares[found].sum()) / total if total > 0.0 else None


def score_of(case: Scored) -> Score:
    """A case of the file of scored cases, compared."""
    truth, answer = case["truth"], case["answer"]
    budget = answer.get("budget", {})
    effects = [effect for effect in truth["effects"] if effect["catalogue"]]
    keys = [{"name": effect["name"], "joint": effect["joint"]} for effect in effects]
    entries: list[Entry] = budget.get("effects", [])
    total = sum(float(entry["tool_mm"] or 0.0) ** 2 for entry in entries)
    true_total = sum(_true_mm2(effect) for effect in truth["effects"])
    reported = tuple(_compared(entry, effects, total, true_total) for entry in entries)
    confirmed = [entry for entry, effect in zip(entries, reported, strict=True) if effect.confirmed]
    true = tuple(
        TrueEffect(
            effect["name"],
            effect["joint"],
            float(effect["tip_mm"] or 0.0),
            float(effect["seen_mm"] or 0.0),
            any(_holds(entry, effect, keys) for entry in confirmed),
        )
        for effect in effects
    )
    return Score(
        case["kind"],
        case["seed"],
        case["number"],
        case["seconds"],
        answer["verdict"],
        reported,
        true,
        budget.get("miss_mm"),
        budget.get("left_mm"),
    )


def _compared(entry: Entry, effects: Sequence[Entry], total: float, true_total: float) -> Reported:
    same = next((effect for effect in effects if _is(entry, effect)), None)
    keys = [{"name": effect["name"], "joint": effect["joint"]} for effect in effects]
    equal = next((effect for effect in effects if _holds(entry, effect, keys)), None)
    figures = np.array([float(entry["evidence"]["figures"].get(name, 0.0)) for name in EVIDENCE_FEATURE_NAMES])
    mm = float(entry["tool_mm"] or 0.0)
    return Reported(
        name=entry["name"],
        joint=entry["joint"],
        figures=figures,
        probability=probability_of(figures),
        mm=mm,
        there=equal is not None,
        by_equal=same is None and equal is not None,
        right=_size_is_right(entry, same) if same is not None else equal is not None,
        inside=None if same is None or same["value"] is None else _within(entry, same, 1.0),
        share=mm**2 / total if total > 0.0 else 0.0,
        true_share=_true_mm2(same) / true_total if same is not None and true_total > 0.0 else None,
    )


def _true_mm2(effect: Entry) -> float:
    return float(effect["tip_mm"] or 0.0) ** 2 + float(effect["seen_mm"] or 0.0) ** 2


def _is(entry: Entry, effect: Entry) -> bool:
    """Whether a reported effect is this true one: name, joint, and the form that it was given (a length of `a`)."""
    if (entry["name"], entry["joint"]) != (effect["name"], effect["joint"]):
        return False
    forms = {key: value for key, value in effect["parameters"].items() if isinstance(value, str)}
    return all(entry["parameters"].get(key, {"value": value})["value"] == value for key, value in forms.items())


def _holds(entry: Entry, effect: Entry, keys: Sequence[Entry]) -> bool:
    """Whether it is this true effect, or one of the sets in its place holds it and is true as a whole."""
    key = {"name": effect["name"], "joint": effect["joint"]}
    true = (members for members in entry["equals"] if all(member in keys for member in members))
    return _is(entry, effect) or any(key in members for members in true)


def _size_is_right(entry: Entry, effect: Entry) -> bool:
    if effect["value"] is None:  # the plant has it, and no number that the catalogue could be held to
        return True
    value, true = _size(entry, effect)["value"], float(effect["value"])
    return abs(value - true) <= CLOSE * abs(true) or _within(entry, effect, WIDER)


def _within(entry: Entry, effect: Entry, wider: float) -> bool:
    size, true = _size(entry, effect), float(effect["value"])
    value, low, high = size["value"], size["low"], size["high"]
    return value - wider * (value - low) <= true <= value + wider * (high - value)


def _size(entry: Entry, effect: Entry) -> dict[str, float]:
    return entry["parameters"][next(iter(effect["parameters"]))]
