"""The budget on whole recordings: named effects and millimetres against a sealed truth."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.diagnosis.sealed.third_plant import draw, write_case
from diagnosis.budget import Budget, budget_of
from diagnosis.reading.read import read_for_diagnosis

SHARED = Path(__file__).resolve().parents[5] / "shared" / "data" / "gap" / "many_at_once"
SEED, NUMBER = 5, 3  # a machine with three joints and 17 effects
Key = tuple[str, int | None]


def key_of(effect: dict[str, Any]) -> Key:
    return effect["name"], effect["joint"]


def budget_in(folder: Path) -> Budget:
    return budget_of(read_for_diagnosis(folder))


def found_in(budget: Budget) -> dict[Key, float]:
    """Effects that are more likely there than not, and their equals, with the millimetres at the tool."""
    out: dict[Key, float] = {}
    for line in budget.effect_lines:
        if line.status == "doubtful":
            continue
        for term in (
            *(term for members in line.evidence.equivalent_effect_sets for term in members),
            line.evidence.effect_term,
        ):
            out[term.effect.name, term.effect.joint] = line.tool_rms_mm
    return out


def false_in(budget: Budget, true: set[Key], above_mm: float) -> list[Key]:
    """Confirmed effects worth more than this that are not there, nor any of their equals."""
    out = []
    for line in budget.confirmed_effects:
        terms = (
            line.evidence.effect_term,
            *(term for members in line.evidence.equivalent_effect_sets for term in members),
        )
        if line.tool_rms_mm > above_mm and not true & {(term.effect.name, term.effect.joint) for term in terms}:
            out.append((line.evidence.effect_term.effect.name, line.evidence.effect_term.effect.joint))
    return out


def test_a_machine_with_many_effects_gets_their_names_and_millimetres(tmp_path: Path) -> None:
    truth = write_case(draw("many", NUMBER, SEED, shorten=0.4), tmp_path)
    budget = budget_in(tmp_path)
    found, true = found_in(budget), {key_of(effect) for effect in truth["effects"]}
    large = [effect for effect in truth["effects"] if effect["tip_mm"] > 2.0]
    assert [key_of(effect) for effect in large if key_of(effect) not in found] == []
    for effect in large:
        assert found[key_of(effect)] == pytest.approx(effect["tip_mm"], rel=0.35, abs=1.0), key_of(effect)
    assert false_in(budget, true, above_mm=1.0) == []
    agreeing = {
        line.evidence.effect_term.effect.without_variant: line.evidence.size_scatter_frac
        for line in budget.effect_lines
    }
    assert max(agreeing.values()) < 0.2, agreeing  # thresholds, too: by the slope, not by the secant
    assert budget.verdict in ("effects", "partly")
    assert budget.left_mm**2 < 0.5 * budget.miss_mm**2


@pytest.mark.skipif(not SHARED.is_dir(), reason=f"the shared recordings are not at {SHARED}")
@pytest.mark.parametrize("case", ["case_001", "case_002"])
def test_the_shared_machines_with_many_effects_at_once(case: str) -> None:
    truth = json.loads((SHARED / "truth.json").read_text(encoding="utf-8"))[case]
    budget = budget_in(SHARED / case)
    found = found_in(budget)
    assert [
        key_of(effect) for effect in truth["effects"] if effect["tip_mm"] > 2.0 and key_of(effect) not in found
    ] == []
    assert false_in(budget, {key_of(effect) for effect in truth["effects"]}, above_mm=1.0) == []
