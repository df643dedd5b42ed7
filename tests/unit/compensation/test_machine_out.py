"""The machine file that a diagnosis writes: read back by the same parser, refused where nothing is settled."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from diagnosis.budget import Budget
from diagnosis.machine_out import MachineOutError, machine_with_effects, require_room
from diagnosis.search.candidates import candidates_of_effects
from diagnosis.search.fit import Fit, entries_of
from machine.description import parse_machine_toml
from server.settings import read_machine_text

TEXT = read_machine_text("hiab033")


def budget(verdict: str, *, confirmed: bool = True) -> Budget:
    """As much of a budget as a machine file is made of."""
    candidates = candidates_of_effects(("gravity_sag",), (2,)) + candidates_of_effects(("hand_eye_rotation",), ())
    fit = Fit(candidates, np.array([1.5e-6, 0.003, -0.004, 0.0]), np.zeros(0), np.zeros((0, 4)), 0.0)
    entries = tuple(entries_of(fit)) if confirmed else ()
    found: Any = SimpleNamespace(
        verdict=verdict, verdict_reason="for a test", confirmed_effects=entries, effect_entries=lambda: entries
    )
    return cast(Budget, found)


def test_the_effects_are_read_back():
    text = machine_with_effects(TEXT, budget("effects"))
    sag, mount = parse_machine_toml(text).effects
    assert (sag.name, sag.joint, sag.value("compliance_rad_nm")) == ("gravity_sag", 2, 1.5e-6)
    assert mount.value("angle_rad") == pytest.approx(0.005)
    assert mount.direction == pytest.approx((0.6, -0.8, 0.0))
    assert "# longreach diagnose: verdict effects, for a test" in text


def test_confirmed_effects_are_written_whatever_another_stage_leaves():
    assert len(parse_machine_toml(machine_with_effects(TEXT, budget("partly"))).effects) == 2


@pytest.mark.parametrize("verdict", ["undecided", "outside"])
def test_nothing_is_written_where_nothing_is_confirmed(verdict):
    with pytest.raises(MachineOutError, match="no effect is confirmed"):
        machine_with_effects(TEXT, budget(verdict, confirmed=False))


@pytest.mark.parametrize(
    "before", ["effect = []\n", "effect = [{ name = 'backlash', joint = 1, parameters = { width_rad = 0.001 } }]\n"]
)
def test_a_list_in_one_line_is_added_to(before: str) -> None:
    effects = parse_machine_toml(machine_with_effects(before + TEXT, budget("effects"))).effects
    assert [one.name for one in effects][-2:] == ["gravity_sag", "hand_eye_rotation"]
    assert len(effects) == 2 + before.count("backlash")


def test_a_text_that_would_be_no_toml_is_refused_before_the_diagnosis() -> None:
    with pytest.raises(MachineOutError, match="effect = 3 is not a list"):
        require_room("effect = 3\n" + TEXT)
