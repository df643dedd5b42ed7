"""The machine file that a diagnosis writes: read back by the same parser, refused where nothing is settled."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from diagnosis.diagnose import Diagnosis
from diagnosis.search.candidates import named
from diagnosis.search.fit import Fit
from longreach.machine_out import MachineOutError, machine_with_effects, require_room
from machine.description import parse_machine_toml
from server.settings import read_machine_text

TEXT = read_machine_text("hiab033")


def diagnosis(word: str) -> Diagnosis:
    """As much of a diagnosis as a machine file is made of."""
    candidates = named(("gravity_sag",), (2,)) + named(("hand_eye_rotation",), ())
    fit = Fit(candidates, np.array([1.5e-6, 0.003, -0.004, 0.0]), np.zeros(0), np.zeros((0, 4)), 0.0, ())
    found: Any = SimpleNamespace(
        verdict=SimpleNamespace(word=word, why="for a test"),
        cells=(SimpleNamespace(chosen=SimpleNamespace(fit=fit)),),
        hypotheses=(SimpleNamespace(probability=0.9),),
    )
    return cast(Diagnosis, found)


@pytest.fixture(autouse=True)
def stated(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the answer states of the first hypothesis; test_diagnosis_answer.py compares it with real answers."""
    monkeypatch.setattr("longreach.machine_out.probability_of_first", lambda found: 0.75)


def test_the_effects_are_read_back():
    text = machine_with_effects(TEXT, diagnosis("effects"))
    sag, mount = parse_machine_toml(text).effects
    assert (sag.name, sag.joint, sag.value("compliance_rad_nm")) == ("gravity_sag", 2, 1.5e-6)
    assert mount.value("angle_rad") == pytest.approx(0.005)
    assert mount.direction == pytest.approx((0.6, -0.8, 0.0))
    assert "# longreach diagnose: verdict effects, probability 0.75" in text


@pytest.mark.parametrize("word", ["undecided", "outside"])
def test_nothing_is_written_of_an_unsettled_diagnosis(word):
    with pytest.raises(MachineOutError, match=f"the diagnosis is '{word}'"):
        machine_with_effects(TEXT, diagnosis(word))


@pytest.mark.parametrize(
    "before", ["effect = []\n", "effect = [{ name = 'backlash', joint = 1, parameters = { width_rad = 0.001 } }]\n"]
)
def test_a_list_in_one_line_is_added_to(before: str) -> None:
    effects = parse_machine_toml(machine_with_effects(before + TEXT, diagnosis("effects"))).effects
    assert [one.name for one in effects][-2:] == ["gravity_sag", "hand_eye_rotation"]
    assert len(effects) == 2 + before.count("backlash")


def test_a_text_that_would_be_no_toml_is_refused_before_the_diagnosis() -> None:
    with pytest.raises(MachineOutError, match="effect = 3 is not a list"):
        require_room("effect = 3\n" + TEXT)
