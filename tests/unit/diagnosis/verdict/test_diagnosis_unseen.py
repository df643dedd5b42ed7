"""What is too small to be seen has its part of the probability, and its names are in the 90 % set."""

from dataclasses import replace
from pathlib import Path

import pytest
from diagnosis_cases import recording

from diagnosis.answer import judgement
from diagnosis.diagnose import diagnose
from diagnosis.reading.read import examine
from diagnosis.report.text import lines
from diagnosis.verdict import unseen
from diagnosis.verdict.unseen import counted_as, one_more, outside_share, unseen_share
from diagnosis.verdict.weigh import calibration


@pytest.fixture(scope="module")
def found():
    return diagnose(examine(recording(("repeat", "repeat", "repeat", "steps", "workcycle")), Path("unseen")))


def counted(monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    numbers = replace(calibration(), unseen_probability=(("none", share),))
    monkeypatch.setattr(unseen, "calibration", lambda: numbers)


def test_without_a_count_only_what_was_weighed_is_in_the_set(found, monkeypatch: pytest.MonkeyPatch) -> None:
    counted(monkeypatch, 0.0)
    result = judgement(found)
    assert result["verdict"] == "none"
    assert result["unseen_probability"] == 0.0
    assert result["credible_set_90"][0]["effects"] == []
    weighed = [sorted((e["name"], e["joint"]) for e in one["effects"]) for one in result["hypotheses"]]
    for row in result["credible_set_90"]:
        assert sorted((e["name"], e["joint"]) for e in row["effects"]) in weighed


def test_all_probabilities_sum_to_one_and_the_set_holds_ninety_percent(found, monkeypatch: pytest.MonkeyPatch) -> None:
    counted(monkeypatch, 0.4)
    result = judgement(found)
    outside = result["outside_probability"]
    assert result["unseen_probability"] == pytest.approx(0.4 * (1.0 - outside), rel=1e-4)
    listed = sum(one["probability"] for one in result["hypotheses"])
    assert listed + result["unseen_probability"] + outside == pytest.approx(1.0, abs=0.01)
    first = result["hypotheses"][0]
    assert first["probability_with_equals"] >= first["probability"]
    rows = result["credible_set_90"]
    held = sum(one["probability"] for one in rows)
    assert 0.9 * (1.0 - outside) <= held <= 0.9 * (1.0 - outside) + max(one["probability"] for one in rows)
    named = [tuple((one["name"], one["joint"]) for one in row["effects"]) for row in rows]
    assert len(set(named)) == len(named) > 5
    assert named[0] == ()
    told = lines({**result, "shapes": [], "next_experiment": {"what": ""}})
    unseen = 100.0 * result["unseen_probability"]
    assert f"{unseen:7.1f} %  one more effect, below its detection limit here" in told


def test_one_more_is_any_other_name_each_once(found) -> None:
    every = one_more(found.cells, frozenset())
    assert sum(part for _, part in every) == pytest.approx(1.0)
    assert [part for _, part in every] == sorted((part for _, part in every), reverse=True)
    assert ("valve_deadband", 1) in dict(every)
    rest = one_more(found.cells, frozenset({("valve_deadband", 1)}))
    assert len(rest) == len(every) - 1


def test_a_verdict_that_was_never_counted_has_none_unseen() -> None:
    assert unseen_share("no such word") == 0.0


def test_names_with_hardly_a_rival_have_shares_of_their_own() -> None:
    assert counted_as("effects", 0.95) == "sure"
    assert counted_as("effects", 0.94) == "effects"
    assert counted_as("none", 1.0) == "none"
    assert outside_share("sure") < outside_share("effects") < outside_share("outside")
    assert unseen_share("sure") < unseen_share("effects")
