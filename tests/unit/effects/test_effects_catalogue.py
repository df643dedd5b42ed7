"""The catalogue holds the names and parameters of the contract, with bounds that make sense."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from machine.effects import catalogue
from machine.effects.layout import neutral_sets, slots_of
from machine.effects.registry import EFFECTS, NAMES, effect_named, effects_of
from machine.effects.spec import STAGES
from machine.errors import MachineError

CONTRACT = {
    "time": {"clock_offset": "offset_s", "clock_drift": "rate_ppm zero_s"},
    "link": {
        "transport_delay": "delay_s",
        "packet_loss": "loss_frac",
        "reference_quantisation": "step_rad",
        "reference_rate_limit": "rate_rad_s",
    },
    "controller": {
        "controller_gain_error": "gain_frac",
        "controller_lag_error": "lag_frac",
        "controller_saturation": "limit_frac",
    },
    "actuator": {
        "valve_deadband": "half_width_frac",
        "valve_lag": "time_constant_s",
        "valve_hysteresis": "half_width_frac",
        "valve_asymmetry": "gain_frac",
        "flow_gain_error": "gain_frac",
        "supply_droop": "flow_limit_frac",
        "internal_leakage": "drift_rad_s",
        "load_droop": "droop_frac",
        "stiction": "breakaway_frac",
        "joint_friction": "compression_rad",
        "oil_compliance": "period_s damping",
    },
    "joint": {
        "backlash": "width_rad",
        "encoder_bias": "bias_rad",
        "encoder_scale": "scale_frac",
        "encoder_eccentricity": "amplitude_rad order phase_rad",
    },
    "structure": {
        "gravity_sag": "compliance_rad_nm",
        "link_length_error": "error_m",
        "base_tilt": "tilt_rad",
        "base_compliance": "compliance_rad_nm",
        "payload_error": "mass_kg",
        "link_flexibility": "frequency_hz damping gain",
        "joint_axis_tilt": "tilt_rad",
    },
    "camera": {
        "focal_length_error": "scale_frac",
        "principal_point_error": "shift_px",
        "lens_distortion": "k1",
        "marker_size_error": "scale_frac",
        "hand_eye_rotation": "angle_rad",
        "hand_eye_translation": "distance_m",
        "tool_marker_rotation": "angle_rad",
        "tool_marker_translation": "distance_m",
        "stereo_misalignment": "angle_rad",
        "camera_latency": "latency_s",
        "rolling_shutter": "readout_s stamp_row",
        "odometry_scale": "scale_frac",
    },
}
NEUTRAL = {"reference_rate_limit": math.inf, "supply_droop": math.inf, "controller_saturation": 1.0}


def test_names_stages_and_parameters_are_the_contracts() -> None:
    ours = {
        stage: {effect.name: {one.name for one in effect.parameters} for effect in effects_of(stage)}
        for stage in STAGES
    }
    assert ours == {stage: {name: set(text.split()) for name, text in of.items()} for stage, of in CONTRACT.items()}


def test_every_file_of_the_catalogue_is_registered() -> None:
    files = [path for path in Path(catalogue.__path__[0]).glob("*.py") if path.stem != "__init__"]
    written = [
        name for path in files for name in re.findall(r'^    Effect\(name="(\w+)"', path.read_text(), re.MULTILINE)
    ]
    assert sorted(written) == sorted(NAMES)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_each_effect_is_complete(effect) -> None:
    assert effect.size.neutral_value == NEUTRAL.get(effect.name, 0.0)
    assert sum(one.role == "size" for one in effect.parameters) == 1
    for text in (
        effect.looks_like,
        effect.distinguished_by,
        effect.source,
        *(one.meaning for one in effect.parameters),
    ):
        assert len(text) > 3
    named = [name for name in NAMES if name in effect.distinguished_by and name != effect.name]
    assert named or effect.name in (
        "base_tilt",
        "payload_error",
        "joint_axis_tilt",
        "encoder_eccentricity",
        "rolling_shutter",
    )


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_a_fit_starts_inside_the_bounds_and_off_neutral(effect) -> None:
    for parameter in effect.parameters:
        assert parameter.plausible_min < parameter.start_value < parameter.plausible_max or parameter.is_integer
        assert parameter.in_bounds(parameter.start_value)
        assert parameter.role == "shape" or parameter.start_value != parameter.neutral_value
        assert parameter.in_bounds(parameter.neutral_value)
        assert parameter.plausible_max <= parameter.highest_value <= parameter.max_admitted
        assert not parameter.in_bounds(parameter.max_admitted * 1.01)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_draws_from_the_prior_stay_inside_the_bounds(effect) -> None:
    rng = np.random.default_rng(1)
    for parameter in effect.parameters:
        values = [parameter.draw_value(rng) for _ in range(200)]
        assert all(parameter.plausible_min <= value <= parameter.plausible_max for value in values)
        assert np.ptp(values) > 0.0


def test_every_slot_of_every_effect_has_a_column_of_its_own() -> None:
    taken: set[tuple[str, int]] = set()
    for effect in EFFECTS:
        for option in effect.quantity_choice.options if effect.quantity_choice else ("",):
            for slot in slots_of(effect.name, 1 if effect.scope == "joint" else None, option):
                assert (slot.scope, slot.column) not in taken, slot
                taken.add((slot.scope, slot.column))
                assert neutral_sets(3).get(slot) == slot.neutral_value
    sizes = {scope: len([one for one in taken if one[0] == scope]) for scope in ("joint", "machine")}
    neutral, held = neutral_sets(3), {"base_tilt": 1}  # about the upright it is the first encoder's bias
    directions = {effect.name: effect.direction for effect in EFFECTS if effect.direction is not None}
    not_fitted = {name: len(one.default_vector) - one.n_fitted_components for name, one in directions.items()}
    assert {name: count for name, count in not_fitted.items() if count > 0} == held
    columns = {"joint": neutral.joint_parameters.shape[2], "machine": neutral.machine_parameters.shape[1]}
    known_swing = 3  # of a joint that has one already: no slot moves it
    assert columns == {"joint": sizes["joint"] + known_swing, "machine": sizes["machine"] + sum(held.values())}


def test_slots_refuse_what_is_not_there() -> None:
    assert effect_named("cable_tug") is None
    with pytest.raises(MachineError, match="not in the catalogue"):
        slots_of("cable_tug", 1)
    with pytest.raises(MachineError, match="belongs to the machine"):
        slots_of("supply_droop", 1)
    with pytest.raises(MachineError, match="belongs to one joint"):
        slots_of("backlash", None)


def test_the_documentation_lists_every_effect_with_its_bounds() -> None:
    text = (Path(__file__).parents[3] / "docs" / "effects.md").read_text(encoding="utf-8")
    lines = {line.split("|")[1].strip(): line for line in text.splitlines() if line.startswith("| ")}
    for effect in EFFECTS:
        line = lines[effect.name]
        assert f"| {effect.stage}, {effect.scope} |" in line
        for one in effect.parameters:
            assert (
                f"`{one.name}` [{one.unit}] {one.plausible_min:g} .. {one.plausible_max:g}, start {one.start_value:g}"
                in line
            )
            assert one.poor_machine_max is None or f"poor ones up to {one.poor_machine_max:g}" in line
            assert one.light_arm_max is None or f"on light arms up to {one.light_arm_max:g}" in line
        assert (
            effect.quantity_choice is None
            or f"`{effect.quantity_choice.name}` {' or '.join(effect.quantity_choice.options)}" in line
        )
