"""What is proposed is judged by what it tells, not by the weightiest pair alone."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.experiments import choice
from diagnosis.experiments.library import Motion

NAMES = ((("valve_lag", 1), ("transport_delay", None)), (("load_droop", 1), None), (("stiction", 1), None))


def proposed(monkeypatch: pytest.MonkeyPatch, nats: dict[str, tuple[float, float, float]]) -> dict[str, Any]:
    cell = SimpleNamespace(stage="actuator", joint=1)
    pairs = [
        SimpleNamespace(differing_effects=two, importance_weight=w, cell=cell)
        for two, w in zip(NAMES, (0.2, 0.19, 0.18), strict=True)
    ]
    library = tuple(Motion(name, "steps", np.zeros((100, 1))) for name in nats)
    monkeypatch.setattr(choice, "_possible_experiments", lambda *_: library)
    monkeypatch.setattr(choice, "_expected_nats", lambda _, pair, one: nats[one.name][pairs.index(pair)])
    found: Any = None
    return choice._best_experiment(found, SimpleNamespace(joint_slides=(False,)), pairs)  # type: ignore[arg-type]


def test_what_settles_two_of_three_pairs_is_no_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    choice = proposed(monkeypatch, {"X": (0.3, 30.0, 30.0), "Y": (25.0, 1.0, 1.0)})
    assert choice["what"] == "X"
    assert choice["separates"] == [{"name": "load_droop", "joint": 1}]
    assert choice["expected_nats"] == 30.0
    assert "load_droop from a sound machine" in choice["why"]
    assert [one["expected_nats"] for one in choice["pairs"]] == [0.3, 30.0, 30.0]


def test_what_tells_nothing_of_any_pair_is_not_proposed(monkeypatch: pytest.MonkeyPatch) -> None:
    choice = proposed(monkeypatch, {"X": (4.0, 4.0, 4.0), "Y": (0.0, 1.0, 1.0)})
    assert choice["what"] is None
    assert "no motion distinguishes valve_lag from transport_delay" in choice["why"]


def test_the_weightiest_pair_that_is_told_is_what_it_is_for(monkeypatch: pytest.MonkeyPatch) -> None:
    choice = proposed(monkeypatch, {"X": (0.3, 5.0, 5.0), "Y": (25.0, 1.0, 1.0)})
    assert choice["what"] == "Y"
    assert choice["alternatives"] == {"X": 0.3, "Y": 25.0}
