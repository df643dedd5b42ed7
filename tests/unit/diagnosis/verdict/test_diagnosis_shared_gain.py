"""Gains that agree in every driven joint: one cause that they share is likelier than as many that happen to agree."""

from pathlib import Path

import pytest
from foreign_plant import Fault, write

from diagnosis.answer import answer
from diagnosis.diagnose import diagnose
from diagnosis.reading.read import read
from diagnosis.search.limits import Interval
from diagnosis.verdict.shared_gain import SHARED_NATS, shared_nats


@pytest.mark.parametrize(
    ("values", "known_to", "shared"),
    [
        ((0.05, 0.05), 0.001, True),
        ((-0.05, -0.051), 0.002, True),
        ((0.05, 0.06), 0.001, False),
        ((0.05, -0.05), 0.001, False),
        ((0.05, 0.05), 0.03, False),  # known too badly to say that they agree
        ((0.05, 0.05, 0.05, 0.2), 0.001, False),
        ((0.0, 0.0), 0.0, False),
    ],
)
def test_agreement_is_weighed_against_chance(values: tuple[float, ...], known_to: float, shared: bool) -> None:
    gains = tuple(Interval(one, one - known_to, one + known_to) for one in values)
    assert (shared_nats(gains) > SHARED_NATS) == shared


@pytest.mark.parametrize(("gain", "verdict"), [((0.1, 0.1), "undecided"), ((0.1, 0.06), "effects")])
def test_what_both_joints_show_alike_is_one_cause(tmp_path: Path, gain: tuple[float, float], verdict: str) -> None:
    found = answer(diagnose(read(write(tmp_path / "run", Fault(gain=gain), seconds=10.0))))
    assert found["verdict"] == verdict, found["why"]
    assert {(one["name"], one["joint"]) for one in found["hypotheses"][0]["effects"]} == {
        ("flow_gain_error", 1),
        ("flow_gain_error", 2),
    }
    assert ("are all 10" in found["why"]) == (verdict == "undecided")
