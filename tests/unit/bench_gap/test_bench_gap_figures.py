"""The tables of the blind benchmark, from made-up judged cases."""

import json
from pathlib import Path

import pytest

from benchmarks.diagnosis.gap import figures
from benchmarks.diagnosis.gap.command import show
from benchmarks.diagnosis.gap.runner import Campaign, scores


def case(mix: str, factor: float | None = None, **changed: object) -> dict:
    name = {"effect": {"name": "valve_lag", "joint": 1}, "limit": 0.01, "factor": factor, "stage": "actuator"}
    count = {"none": 0, "single": 1, "double": 2}.get(mix, 1)
    base = {
        "number": 0, "seed": 1, "mix": mix, "noise": 0, "effects": [name] * count, "lacking": "",
        "verdict": "effects", "why": "", "named": [["valve_lag", 1]], "refused": False, "exact": True,
        "exact_named": True, "some": True, "false": [], "none": False, "stage_right": True,
        "probabilities": [[0.95, True]],
        "credible": True, "credible_size": 1, "classes": [], "closed": {"closed_frac": 0.99}, "limits": [],
        "values": [], "strengths": [factor] * count,
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


def test_probabilities_are_held_against_what_is_there() -> None:
    cases = [case("single", 3.0, probabilities=[[0.99, True], [0.6, False]]), case("none", probabilities=[[0.6, True]])]
    rows = {name: (count, right) for name, count, _, right in figures.reliability(cases)}
    assert rows == {"0.5 to 0.9": (2, 0.5), "0.98 to 1": (1, 1.0)}


def test_what_is_on_file_is_told_with_its_count(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    asked = Campaign("own", 7, tmp_path)
    folder = asked.place / "case00001"
    folder.mkdir(parents=True)
    (folder / "score.json").write_text(json.dumps(case("single", 3.0)), encoding="utf-8")
    found = scores(asked, range(3))
    show(found, "made up")
    assert "N reached 1" in capsys.readouterr().out
    show([], "nothing")
    assert "N reached 0" in capsys.readouterr().out
