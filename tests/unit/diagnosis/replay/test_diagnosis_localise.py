"""Stages replayed with their own inputs: nothing is left of a nominal machine, and each gap lies where it was put."""

from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import entry, recording

from diagnosis.localise import error_above_floor, localise, merged_stages
from diagnosis.reading.read import examine_recording
from diagnosis.regimes import regimes_of
from diagnosis.replay.replayer import replayer_of
from machine.effects.entries import EffectEntry
from machine.effects.layout import neutral_sets


def places(*effects: EffectEntry):
    return localise(examine_recording(recording(effects=effects), Path("made_up")))


def test_nothing_is_left_of_a_nominal_machine() -> None:
    found = places()
    assert found.floor_known
    whole = [place for place in found.gap_places if place.motion_regime == "all"]
    assert {one.stage for one in whole} == {"link", "controller", "actuator"}
    assert len(whole) == 18
    for one in whole:
        assert one.tcp_mm < 0.2, one


CASES = {
    "transport_delay": (entry("transport_delay", None, delay_s=0.03), "link", None),
    "controller_gain_error": (entry("controller_gain_error", 2, gain_frac=0.2), "controller", 2),
    "controller_lag_error": (entry("controller_lag_error", 3, lag_frac=0.8), "controller", 3),
    "valve_deadband": (entry("valve_deadband", 3, half_width_frac=0.05), "actuator", 3),
    "valve_lag": (entry("valve_lag", 1, time_constant_s=0.1), "actuator", 1),
    "stiction": (entry("stiction", 4, breakaway_frac=0.15), "actuator", 4),
    "flow_gain_error": (entry("flow_gain_error", 2, gain_frac=-0.2), "actuator", 2),
}


@pytest.mark.parametrize("name", CASES)
def test_each_gap_lies_where_it_was_put(name: str) -> None:
    effect, stage, joint = CASES[name]
    found = places(effect)
    top = found.gap_places[0]
    assert top.stage == stage
    assert joint is None or top.joint == joint
    assert top.model_gap > 5.0 * top.noise_floor
    share = sum(place.tcp_mm**2 for place in found.gap_places if place.stage == stage and place.motion_regime == "all")
    rest = sum(place.tcp_mm**2 for place in found.gap_places if place.stage != stage and place.motion_regime == "all")
    assert share > 9.0 * rest


def test_a_stage_is_judged_by_its_own_input_even_when_another_one_is_wrong() -> None:
    """Dead band and controller gain together: each shows on its own stage and joint."""
    found = places(entry("valve_deadband", 3, half_width_frac=0.05), entry("controller_gain_error", 2, gain_frac=0.2))
    best = {stage: next(p for p in found.gap_places if p.stage == stage) for stage in ("controller", "actuator")}
    assert (best["controller"].joint, best["actuator"].joint) == (2, 3)


def test_the_true_parameters_leave_the_floor() -> None:
    effect = entry("valve_deadband", 3, half_width_frac=0.05)
    whole = examine_recording(recording(effects=(effect,)), Path("made_up"))
    assert whole.nominal_machine is not None
    replayer = replayer_of(whole.nominal_machine, whole.stretches)
    assert replayer is not None
    assert replayer.torque_reference is not None
    sets = neutral_sets(6, 2)
    sets.joint_parameters[1, 2, 7] = 0.05  # the dead band's column
    error = replayer.residuals("actuator", replayer.prepare(whole.stretches[0]), sets)
    assert error is not None
    nominal, true = (np.sqrt(np.mean(np.diff(one[:, 2]) ** 2)) for one in error)
    assert true < 0.15 * nominal


def test_regimes_part_a_motion() -> None:
    t = np.arange(0.0, 10.0, 0.05)
    masks = regimes_of(np.where(t < 8.0, np.sin(np.pi * t / 4.0), 0.0), 0.05)
    assert masks["all"].all()
    assert masks["forward"][:39].all()
    assert masks["backward"][45:110].all()
    assert masks["still"][-30:].all()
    assert masks["reversal"][40]
    assert not masks["reversal"][20]
    assert not (masks["forward"] & masks["backward"]).any()


def test_excess_is_beyond_the_floor_and_never_below_zero() -> None:
    error = np.array([3.0, -5.0, 3.0, -5.0])
    assert error_above_floor(error, 1.0) == pytest.approx(4.0)
    assert error_above_floor(error, 9.0) == 0.0


def test_merged_stages_are_said_with_the_missing_signal() -> None:
    merged = merged_stages(examine_recording(recording(("steps",)), Path("made_up")))
    assert merged == (
        (("joint", "structure", "camera"), "nothing was measured behind the encoders: no camera, no tracker"),
    )
