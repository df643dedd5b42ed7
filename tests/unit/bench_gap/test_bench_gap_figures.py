"""The tables of the blind benchmark, from made-up judged cases."""

import json
from pathlib import Path

import pytest

from benchmarks.diagnosis.gap import calibrate, figures, reliability
from benchmarks.diagnosis.gap.command import tell
from benchmarks.diagnosis.gap.runner import Campaign, scores


def case(mix: str, factor: float | None = None, **changed: object) -> dict:
    name = {"effect": {"name": "valve_lag", "joint": 1}, "limit": 0.01, "factor": factor, "stage": "actuator"}
    count = {"none": 0, "single": 1, "double": 2}.get(mix, 1)
    base = {
        "number": 0, "seed": 1, "mix": mix, "noise": 0, "effects": [name] * count, "lacking": "",
        "verdict": "effects", "why": "", "named": [["valve_lag", 1]], "refused": False, "exact": True,
        "exact_named": True, "some": True, "false": [], "none": False, "probability": 0.95, "stage_right": True,
        "credible": True, "credible_size": 1, "classes": [], "closed": {"closed_frac": 0.99}, "limits": [],
        "values": [], "rivals": {}, "left_out": [], "strengths": [factor] * count, "ladder": [],
    }  # fmt: skip
    return {**base, **changed}


def shown(lines: list[figures.Line], claim: str) -> tuple[int, int]:
    found = next(one.share for one in lines if one.claim == claim)
    assert found is not None
    return found.k, found.n


def test_names_are_counted_from_twice_the_limit_on() -> None:
    cases = [case("single", 3.0), case("single", 3.0, exact=False, exact_named=False), case("single", 1.0, exact=False)]
    lines = figures.naming(cases)
    assert shown(lines, "single exact") == (1, 2)
    assert shown(lines, "0.5x to 2x: exact") == (0, 1)
    assert shown(figures.by_factor(cases), "single exact, 1x to 2x") == (0, 1)


def test_the_tools_own_limit_is_where_its_sizes_are_counted_from() -> None:
    limits = [{"name": "backlash", "joint": 1, "scorer": 2.0, "tool": 3.0}]  # 1.5x the scorer's limit is the tool's
    cases = [
        case("single", 1.5, limits=limits),
        case("single", 1.6, limits=limits, exact_named=False),
        case("single", 3.0, limits=limits),
        case("double", 1.5, limits=limits * 2),
    ]
    lines = figures.by_own_limit(cases)
    assert shown(lines, "named, 0.85x to 1.2x the tool's limit") == (1, 2)
    assert shown(lines, "seen (not `none`), 0.85x to 1.2x the tool's limit") == (2, 2)
    assert shown(lines, "named, 1.6x to 100x the tool's limit") == (1, 1)


def test_false_names_and_refusals() -> None:
    cases = [
        case("none", named=[], none=True, exact=False),
        case("none", false=[["valve_lag", 1]]),
        case("foreign", refused=True, exact=False),
        case("lacking", 4.0, refused=False, false=[["valve_lag", 1]]),
    ]
    lines = figures.naming(cases)
    assert shown(lines, "none called none") == (1, 2)
    assert shown(lines, "false names") == (1, 2)
    assert shown(lines, "foreign refused or undecided") == (1, 1)
    assert shown(lines, "lacking refused or undecided") == (0, 1)
    assert shown(lines, "false names, outside the catalogue") == (1, 2)
    assert len(figures.failures(cases)) == 2


def test_a_case_counts_by_its_strength_on_the_recording_not_by_the_tables_limit() -> None:
    cases = [
        case("single", 3.0, strengths=[1.2]),
        case("single", 1.5, strengths=[2.1]),
        case("foreign", strengths=[0.7]),
    ]
    assert figures.large(cases) == [cases[1]]
    assert figures.small(cases) == [cases[0], cases[2]]


def test_probabilities_are_fitted_to_what_turned_out_right() -> None:
    """Told 70 % each time and right 19 times in 20: sharper; half the refusals were of causes outside."""
    sure = case("single", 3.0, ladder=[[1, 0.7, True], [2, 0.3, False]], probability=0.7)
    wrong = case("single", 3.0, ladder=[[1, 0.7, False], [2, 0.3, True]], probability=0.7, exact_named=False)
    refused = [case(mix, verdict="outside", refused=True, ladder=[]) for mix in ("none", "foreign")]
    cases = [*[sure] * 57, *[wrong] * 3, *refused]
    found = calibrate.fit(cases)
    assert found.outside["outside"] == pytest.approx(0.5)
    assert found.outside["effects"] < 0.01
    again = calibrate.restated(cases, found)
    assert again[0]["probability"] == pytest.approx(0.95, abs=0.03)
    text = json.dumps({"temperature": 1.0, "temperature_without_floor": 3.0, "penalty_nats_per_effect": 8.0})
    data = json.loads(calibrate.calibrated(text, found, reliability.by_width(again), "62 made-up cases"))
    assert data["temperature"] <= 1.0
    assert data["penalty_nats_per_effect"] > 8.0
    assert data["fitted_on"] == "62 made-up cases"


def test_what_is_unseen_makes_the_mean_of_what_is_stated_the_share_that_was_right() -> None:
    seen = case("none", verdict="none", ladder=[[0, 0.9, True]], named=[])
    small = case("single", 0.6, verdict="none", ladder=[[0, 0.9, False], [1, 0.1, True]], exact_named=False)
    found = calibrate.fit([seen, seen, small])
    assert found.unseen["none"] == pytest.approx(1.0 - 2.5 / 3.7, abs=1e-4)
    assert calibrate.restated([seen], found)[0]["probability"] < 1.0 - found.unseen["none"]
    text = json.dumps({"temperature": 1.0, "temperature_without_floor": 3.0, "penalty_nats_per_effect": 8.0})
    assert json.loads(calibrate.calibrated(text, found, [], ""))["unseen_probability"] == found.unseen


def test_reliability_puts_a_whole_probability_into_the_last_bin() -> None:
    cases = [case("single", 3.0, probability=1.0), case("single", 3.0, probability=0.5, exact_named=False)]
    rows = {name: (count, right) for name, count, _, right in reliability.by_width(cases)}
    assert rows == {"0.4 to 0.6": (1, 0.0), "0.8 to 1": (1, 1.0)}


def test_equals_are_stated_as_one_since_they_count_as_right() -> None:
    ladder = [[1, 0.4, True], [1, 0.3, False], [1, 0.2, False]]
    one = case("single", 3.0, probability=0.2, ladder=ladder, equals=[0, 2])  # half of all is outside or unseen
    assert reliability.stated(one) == pytest.approx(0.3)
    assert reliability.stated(case("single", 3.0, probability=0.2, ladder=ladder)) == pytest.approx(0.2)


def test_fifths_hold_as_many_cases_each_however_probabilities_crowd() -> None:
    cases = [case("single", 3.0, probability=0.7 + 0.001 * k, exact_named=k >= 6) for k in range(10)]
    rows = reliability.by_fifths(cases)
    assert [count for _, count, _, _ in rows] == [2] * 5
    assert [right for *_, right in rows] == [0.0, 0.0, 0.0, 1.0, 1.0]
    assert reliability.by_fifths(cases[:2]) != []


def test_names_with_hardly_a_rival_are_counted_apart() -> None:
    sure = case("single", 3.0, ladder=[[1, 0.7, True], [1, 0.26, False]], equals=[0, 1])
    assert calibrate.heading(sure) == "sure"
    assert calibrate.heading({**sure, "equals": [0]}) == "effects"
    assert calibrate.heading({**sure, "verdict": "none"}) == "none"


def test_packed_scores_that_do_not_say_what_the_equals_are_count_only_where_there_are_none() -> None:
    told, alone, unknown = case("single", equals=[0], classes=[3]), case("single"), case("single", classes=[1, 3])
    assert calibrate.with_equals_known([told, alone, unknown]) == [told, alone]


def test_leave_out_needs_the_refusal_and_the_stage() -> None:
    row = {"name": "valve_lag", "refused": True, "claimed": [], "stage_right": True}
    cases = [case("single", 3.0, left_out=[row]), case("single", 3.0, left_out=[{**row, "stage_right": False}])]
    assert shown(figures.left_out(cases), "refused or undecided, and the right stage") == (1, 2)
    assert shown(figures.left_out(cases), "  valve_lag") == (1, 2)
    equal = {**row, "refused": False, "claimed": [["flow_gain_error", 1]], "twin": True}
    assert shown(figures.left_out([case("single", 3.0, left_out=[equal])]), "named its equal (T < 9)") == (1, 1)


def test_what_held_out_data_cannot_tell_apart_is_counted_among_the_names_in_its_place() -> None:
    row = {"name": "encoder_bias", "refused": False, "stage_right": True}
    rows = [{**row, "claimed": [["encoder_scale", 2]], "lost_nats": nats} for nats in (3.0, 70.0, None)]
    told = figures.left_out([case("single", 3.0, left_out=[one]) for one in (*rows, {**row, "claimed": []})])
    assert shown(told, "of what was named in its place: held-out data lose less than 16 nats by it") == (1, 2)


def test_what_is_on_file_is_told_with_its_count(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    asked = Campaign("own", 7, tmp_path)
    folder = asked.place / "case00001"
    folder.mkdir(parents=True)
    (folder / "score.json").write_text(json.dumps(case("single", 3.0)), encoding="utf-8")
    found = scores(asked, range(3))
    tell(found, "made up")
    assert "N reached 1" in capsys.readouterr().out
    tell([], "nothing")
    assert "N reached 0" in capsys.readouterr().out
