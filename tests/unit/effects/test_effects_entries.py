"""[[effect]] entries: read, refused with a remedy, written back, packed."""

import math
import tomllib

import numpy as np
import pytest

from machine.effects.entries import EffectEntry, entries_to_toml, make_entry, pack_effects, pack_under, parse_entries
from machine.effects.kernel import DEADBAND, FLEX_GAIN, FLEX_HZ, FLOW_LIMIT, KNOWN_GAIN, KNOWN_HZ, RATE
from machine.effects.layout import HAND_EYE_ROTATION, LENGTH_A, LENGTH_D, neutral_sets
from machine.effects.registry import EFFECTS
from machine.errors import MachineFileError


def read(text: str, n: int = 6) -> tuple[EffectEntry, ...]:
    return parse_entries(tomllib.loads(text).get("effect"), n)


def test_a_file_without_effects_has_none() -> None:
    assert read("[machine]\nname = 'x'\n") == ()
    assert np.array_equal(pack_effects((), 6).joint_parameters, neutral_sets(6).joint_parameters)


def test_entries_are_read() -> None:
    (entry,) = read('[[effect]]\nname = "valve_deadband"\njoint = 2\nparameters = { half_width_frac = 0.03 }')
    assert entry == EffectEntry("valve_deadband", 2, (("half_width_frac", 0.03),), "kept")
    (tilt,) = read('[[effect]]\nname = "base_tilt"\nparameters = { tilt_rad = 0.02, axis = [0, 2, 0] }')
    assert tilt.direction == (0.0, 1.0, 0.0)
    (length,) = read('[[effect]]\nname = "link_length_error"\njoint = 4\nparameters = { error_m = 0.02, of = "d" }')
    assert (length.option, length.value("error_m")) == ("d", 0.02)
    (limit,) = read('[[effect]]\nname = "supply_droop"\nparameters = { flow_limit_frac = inf }')
    assert limit.value("flow_limit_frac") == math.inf


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('name = "valve_deadbnd"\njoint = 1', "not in the catalogue; nearest: valve_deadband"),
        (
            'name = "valve_deadband"\njoint = 7\nparameters = { half_width_frac = 0.1 }',
            "joint = 7; give a whole number 1 .. 6",
        ),
        ('name = "valve_deadband"\nparameters = { half_width_frac = 0.1 }', "joint = None"),
        ('name = "base_compliance"\njoint = 1\nparameters = { compliance_rad_nm = 0 }', "belongs to the whole machine"),
        (
            'name = "valve_deadband"\njoint = 1\nparameters = { half_width_frac = 0.9 }',
            r"0.9 is outside 0 .. 0.7 \[1\]",
        ),
        (
            'name = "gravity_sag"\njoint = 1\nparameters = { compliance_rad_nm = 1 }',
            r"1 is outside 0 .. 0.01 \[rad/\(N m\)\]",
        ),
        (
            'name = "valve_deadband"\njoint = 1\nparameters = { half_width = 0.1 }',
            "unknown parameter 'half_width'; nearest: half_width_frac",
        ),
        ('name = "valve_deadband"\njoint = 1', "half_width_frac is missing"),
        ('name = "valve_deadband"\njoint = 1\nparameters = { half_width_frac = "0.1" }', "'0.1' is not a number"),
        ('name = "valve_deadband"\njoint = 1\nparameters = { half_width_frac = nan }', "nan is not a number"),
        ('name = "valve_deadband"\njoint = 1\nparameter = { half_width_frac = 0.1 }', "unknown key 'parameter'"),
        (
            'name = "link_length_error"\njoint = 1\nparameters = { error_m = 0.1, of = "b" }',
            "of = 'b'; give 'a' or 'd'",
        ),
        ('name = "base_tilt"\nparameters = { tilt_rad = 0.1, axis = [0, 0, 0] }', "3 numbers, not all 0, in base axes"),
        ('name = "base_tilt"\nparameters = { tilt_rad = 0.1, axis = "x" }', "3 numbers, not all 0"),
        (
            'name = "encoder_eccentricity"\njoint = 1\nparameters = { amplitude_rad = 0.01, order = 1.5 }',
            "1.5 is outside whole numbers 1 .. 4",
        ),
        (
            'name = "reference_rate_limit"\njoint = 1\nparameters = { rate_rad_s = 9.0 }',
            r"0.005 .. 3 \(neutral inf\) \[rad/s\]",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_remedy(body: str, message: str) -> None:
    with pytest.raises(MachineFileError, match=message):
        read(f"[[effect]]\n{body}\n")


def test_a_list_that_is_none_is_refused() -> None:
    with pytest.raises(MachineFileError, match="is not a list"):
        parse_entries({"name": "backlash"}, 6)
    with pytest.raises(MachineFileError, match="effect 1 is not a table"):
        parse_entries(["backlash"], 6)


def test_every_effect_written_is_read_back_the_same() -> None:
    rng = np.random.default_rng(2)
    entries = []
    for effect in EFFECTS:
        parameters: dict[str, object] = {entry.name: entry.draw_value(rng) for entry in effect.parameters}
        if effect.quantity_choice:
            parameters[effect.quantity_choice.name] = effect.quantity_choice.options[1]
        if effect.direction:
            parameters[effect.direction.name] = [
                float(x) for x in rng.normal(size=len(effect.direction.default_vector))
            ]
        entries.append(make_entry(effect, 3 if effect.scope == "joint" else None, parameters))
    back = read(entries_to_toml(entries))
    assert [one.name for one in back] == [one.name for one in entries]
    for one, two in zip(back, entries, strict=True):
        assert (one.joint, one.option, one.values) == (two.joint, two.option, two.values)
        assert one.direction == pytest.approx(two.direction, abs=1e-15)


def entry(name: str, joint: int | None, **parameters: object) -> EffectEntry:
    return make_entry(next(one for one in EFFECTS if one.name == name), joint, parameters)


def test_an_effect_beyond_a_baseline_adds_and_limits_take_the_smaller() -> None:
    packed = pack_effects(
        [
            entry("valve_deadband", 2, half_width_frac=0.03),
            entry("valve_deadband", 2, half_width_frac=0.02),
            entry("reference_rate_limit", 1, rate_rad_s=0.5),
            entry("reference_rate_limit", 1, rate_rad_s=0.2),
            entry("supply_droop", None, flow_limit_frac=0.7),
            entry("link_length_error", 3, error_m=0.01, of="a"),
            entry("link_length_error", 3, error_m=0.02, of="d"),
            entry("link_flexibility", 3, gain=0.1, frequency_hz=4.0),
            entry("hand_eye_rotation", None, angle_rad=0.02, axis=[1.0, 0.0, 0.0]),
            entry("hand_eye_rotation", None, angle_rad=0.01, axis=[0.0, 0.0, -2.0]),
        ],
        6,
    )
    assert packed.joint_parameters[0, 1, DEADBAND] == pytest.approx(0.05)
    assert packed.joint_parameters[0, 0, RATE] == 0.2
    assert packed.machine_parameters[0, FLOW_LIMIT] == 0.7
    assert packed.joint_parameters[0, 2, [LENGTH_A, LENGTH_D]] == pytest.approx([0.01, 0.02])
    assert packed.joint_parameters[0, 2, FLEX_HZ] == 4.0
    assert packed.joint_parameters[0, 2, KNOWN_GAIN] == 0.0
    assert packed.machine_parameters[0, HAND_EYE_ROTATION] == pytest.approx([0.02, 0.0, -0.01])


def test_a_second_swing_of_a_joint_keeps_its_own_frequency_and_a_third_is_refused() -> None:
    swings = [entry("link_flexibility", 2, gain=gain, frequency_hz=hz) for gain, hz in ((0.9, 3.8), (0.2, 2.1))]
    both = pack_effects(swings, 3).joint_parameters[0, 1]
    assert both[[FLEX_GAIN, FLEX_HZ, KNOWN_GAIN, KNOWN_HZ]] == pytest.approx([0.2, 2.1, 0.9, 3.8])
    assert read(entries_to_toml(swings)) == tuple(swings)
    with pytest.raises(MachineFileError, match="link_flexibility, joint 2: a third oscillation"):
        read(entries_to_toml([*swings, swings[0]]))


def test_what_a_hypothesis_is_put_on_leaves_it_a_swing_of_its_own() -> None:
    known = entry("link_flexibility", 1, gain=0.9, frequency_hz=3.8)
    under = pack_under([known], 2).joint_parameters[0, 0]
    assert under[[FLEX_GAIN, KNOWN_GAIN, KNOWN_HZ]] == pytest.approx([0.0, 0.9, 3.8])
    assert under[FLEX_HZ] == neutral_sets(1).joint_parameters[0, 0, FLEX_HZ]
    full = [known, entry("link_flexibility", 1, gain=0.2, frequency_hz=2.1)]
    assert np.array_equal(pack_under(full, 2).joint_parameters, pack_effects(full, 2).joint_parameters)


def test_a_parameter_that_an_effect_does_not_have_is_refused_where_entries_are_packed() -> None:
    wrong = EffectEntry("encoder_bias", 1, (("bias_deg", 0.1),))
    with pytest.raises(MachineFileError, match="'encoder_bias': unknown parameter 'bias_deg'; nearest: bias_rad"):
        pack_effects((wrong,), 3)


@pytest.mark.parametrize(
    ("name", "parameter", "joint", "sizes", "told"),
    [
        ("valve_deadband", "half_width_frac", 2, (0.5, 0.5), "joint 2: its entries add up to 1; they must stay below"),
        ("flow_gain_error", "gain_frac", 3, (-0.6, -0.6), "joint 3: its entries add up to -1.2; they must stay above"),
        ("controller_gain_error", "gain_frac", 1, (-0.5, -0.5), "add up to -1"),
        ("packet_loss", "loss_frac", None, (0.5, 0.5), "packet_loss: its entries add up to 1"),
    ],
)
def test_sums_that_leave_nothing_are_refused(name, parameter, joint, sizes, told) -> None:
    where = "" if joint is None else f"joint = {joint}\n"
    text = "".join(f'[[effect]]\nname = "{name}"\n{where}parameters = {{ {parameter} = {x} }}\n' for x in sizes)
    with pytest.raises(MachineFileError, match=told):
        read(text)
    assert len(read(text.replace(str(sizes[0]), str(0.1 * sizes[0])))) == 2
