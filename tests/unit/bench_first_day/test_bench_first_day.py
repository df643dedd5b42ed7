"""Scores of the bench of the first day against made-up truths, its tables, and the calibration that it fits."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.diagnosis.first_day import runner
from benchmarks.diagnosis.first_day.figures import failures, reliability, rows, wilson
from benchmarks.diagnosis.first_day.runner import MIXTURE, Campaign, run_campaign
from benchmarks.diagnosis.first_day.score import score_of
from diagnosis.whole_model.probability import CONFIRMED_PROBABILITY, EVIDENCE_FEATURE_NAMES, probability_of
from longreach.cli import app

STRONG = dict.fromkeys(EVIDENCE_FEATURE_NAMES, 20.0)
WEAK = dict.fromkeys(EVIDENCE_FEATURE_NAMES, -20.0)


def true(name: str, joint: int | None, tip_mm: float, **parameters: Any) -> dict[str, Any]:
    value = next(iter(parameters.values()))
    shared = {"catalogue": True, "seen_mm": 0.0, "value": value, "parameters": parameters}
    return {"name": name, "joint": joint, "tip_mm": tip_mm, **shared}


def said(
    name: str, joint: int | None, mm: float, numbers: dict[str, Any], equals: tuple[str, ...] = (), strong: bool = True
) -> dict[str, Any]:
    """A reported effect; numbers: value, low, high of each parameter, or a word."""
    parameters = {
        key: {"value": given} if isinstance(given, str) else dict(zip(("value", "low", "high"), given, strict=True))
        for key, given in numbers.items()
    }
    members = [[{"name": other, "joint": joint}] for other in equals]
    evidence = {"figures": STRONG if strong else WEAK}
    return {
        "name": name,
        "joint": joint,
        "tool_mm": mm,
        "parameters": parameters,
        "equals": members,
        "evidence": evidence,
    }


def case(truth: list[dict[str, Any]], effects: list[dict[str, Any]], kind: str = "many", **more: Any) -> dict[str, Any]:
    budget = {"effects": effects, "miss_mm": 10.0, "left_mm": 2.0}
    answer = {"verdict": "effects", "budget": budget}
    whole = {"kind": kind, "seed": 1000, "number": 0, "seconds": 30.0, "truth": {"effects": truth}, "answer": answer}
    return whole | more


BIAS = true("encoder_bias", 2, 8.0, bias_rad=0.005)
LENGTH = true("link_length_error", 2, 6.0, error_m=0.004, of="a")


def test_strong_evidence_is_confirmed_and_weak_is_not() -> None:
    strong, weak = (probability_of(np.array(list(figures.values()))) for figures in (STRONG, WEAK))
    assert strong > CONFIRMED_PROBABILITY > 0.5 > weak


def test_a_found_effect_covers_its_squares_and_a_doubtful_one_does_not() -> None:
    effects = [
        said("encoder_bias", 2, 8.0, {"bias_rad": (0.0051, 0.0049, 0.0053)}),
        said("link_length_error", 2, 6.0, {"error_m": (0.004, 0.003, 0.005), "of": "a"}, strong=False),
    ]
    score = score_of(case([BIAS, LENGTH], effects))
    assert score.coverage(seen=False) == pytest.approx(64.0 / 100.0)
    assert score.coverage(seen=True) is None
    assert [effect.inside for effect in score.reported] == [True, True]
    assert score.reported[0].true_share == pytest.approx(0.64)
    assert [effect.right for effect in score.reported] == [True, True]


@pytest.mark.parametrize(
    ("entry", "there", "right"),
    [
        (said("encoder_bias", 2, 1.0, {"bias_rad": (0.007, 0.0059, 0.0081)}), True, True),  # inside of twice the limits
        (said("encoder_bias", 2, 1.0, {"bias_rad": (0.0054, 0.00539, 0.00541)}), True, True),  # within 10 %
        (said("encoder_bias", 2, 1.0, {"bias_rad": (0.007, 0.0069, 0.0071)}), True, False),
        (said("encoder_bias", 3, 1.0, {"bias_rad": (0.005, 0.004, 0.006)}), False, False),
        (said("gravity_sag", 2, 1.0, {"compliance_rad_nm": (1e-6, 0.0, 2e-6)}, ("encoder_bias",)), True, True),
        (said("link_length_error", 2, 1.0, {"error_m": (0.004, 0.003, 0.005), "of": "d"}), False, False),
    ],
)
def test_what_is_there_and_what_is_right(entry: dict[str, Any], there: bool, right: bool) -> None:
    (effect,) = score_of(case([BIAS, LENGTH], [entry])).reported
    assert (effect.there, effect.right) == (there, right)


def test_an_effect_outside_the_catalogue_is_never_there() -> None:
    foreign = true("thermal_gain_drift", 2, 5.0, gain_frac=0.2) | {"catalogue": False}
    score = score_of(case([foreign], [said("flow_gain_error", 2, 5.0, {"gain_frac": (0.2, 0.1, 0.3)})], "foreign"))
    assert [effect.there for effect in score.reported] == [False]
    table = {what: reached for what, _, reached in rows([score])}
    assert table["foreign: no effect confirmed that is not there"].startswith("0.0 %")
    assert "flow_gain_error 2" in failures([score])[0]


def test_wilson_is_the_interval_of_his_paper() -> None:
    share = wilson([True] * 8 + [False] * 2)
    assert (share.low, share.high) == (pytest.approx(0.4902, abs=1e-4), pytest.approx(0.9433, abs=1e-4))


def test_reliability_bins_hold_every_effect_once() -> None:
    curve = reliability([0.0, 0.1, 0.55, 1.0], [False, False, True, True])
    assert [(name, share.n) for name, _, share in curve] == [("0 to 0.2", 2), ("0.4 to 0.6", 1), ("0.8 to 1", 1)]


def test_the_mixture_holds_every_kind_in_its_share() -> None:
    kinds = Counter(Campaign("mixed", 1, Path()).kind_of(number) for number in range(len(MIXTURE) * 10))
    shares = {kind: count / sum(kinds.values()) for kind, count in kinds.items()}
    assert 0.38 < shares["many"] < 0.45
    assert 0.15 < shares["foreign"] + shares["foreign_many"] < 0.21
    assert 0.08 < shares["healthy"] + shares["healthy_no_repeats"] < 0.12
    assert {"no_repeats", "one_job", "no_tracker", "camera_only", "static_only"} <= set(shares)


def test_a_second_run_goes_on_where_the_first_one_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[int] = []

    def made(_campaign: Campaign, number: int) -> dict[str, Any] | None:
        ran.append(number)
        return None if ran.count(number) == 1 and number == 1 else case([], [], number=number)

    monkeypatch.setattr(runner, "_case", made)
    campaign = Campaign("many", 7, tmp_path)
    assert run_campaign(campaign, range(3)) == 1
    assert run_campaign(campaign, range(3)) == 0
    assert ran == [0, 1, 2, 1]
    assert sorted(effect["number"] for effect in runner.read_scored([campaign.scored])) == [0, 1, 2]


def scored_file(folder: Path, both: bool = True) -> Path:
    """Forty cases: strong evidence where the effect is there, weak where it is not."""
    lines = []
    for k in range(40):
        strong = k % 2 == 0 or not both
        name = "encoder_bias" if strong else "gravity_sag"
        entry = said(name, 2, 8.0, {"bias_rad": (0.005, 0.004, 0.006)}, strong=strong)
        lines.append(json.dumps(case([BIAS], [entry], number=k)))
    (folder / "scored.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "scored.jsonl"


def test_the_command_reports_scored_cases_and_fits_the_calibration(tmp_path: Path) -> None:
    out = tmp_path / "calibration.json"
    done = CliRunner().invoke(app, ["bench", "first-day", str(scored_file(tmp_path)), "--calibrate", str(out)])
    assert done.exit_code == 0, done.output
    assert "N = 40 cases, seed 1000" in done.output
    table = json.loads(out.read_text(encoding="utf-8"))
    assert (table["cases"], table["effects"], table["right"], table["seeds"]) == (40, 40, 20, [1000])
    assert min(table["weights"].values()) >= 0.0
    assert np.isfinite([table["intercept"], *table["weights"].values()]).all()
    assert [effect["share_right"] for effect in table["reliability"]] == [0.0, 1.0]


def test_labels_of_one_sort_fit_nothing(tmp_path: Path) -> None:
    out = tmp_path / "calibration.json"
    done = CliRunner().invoke(app, ["bench", "first-day", str(scored_file(tmp_path, False)), "--calibrate", str(out)])
    assert done.exit_code == 2
    assert "more cases are needed" in done.output
    assert not out.exists()
