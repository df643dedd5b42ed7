"""The simulator's plant driven by a recording, without a clock."""

from dataclasses import replace

import numpy as np
import pytest

from machine.description import parse_machine_toml
from machine.effects.arm import arm_of
from machine.effects.dynamics import actuators_of, drive_by_sent, simulate
from machine.effects.entries import EffectEntry, pack_effects
from machine.effects.structure import tcp_poses
from server.settings import read_machine_text
from sim_plc.plant.tree import MOTOR_JOINT_INDICES
from sim_plc.presets import PresetError
from tests.unit.sim_plc.recorded_drive import (
    at_rest,
    follow_commands,
    follow_reference,
    follow_sent,
    offline,
    plain_world,
)

MACHINE = parse_machine_toml(read_machine_text("hiab033"))
Q_START = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4])
T_S = np.arange(0.0, 4.0, 0.01)


@pytest.fixture(scope="module")
def plain():
    return plain_world(MACHINE)


def effect(name, value, joint=2, parameter=""):
    return EffectEntry(name, joint, ((parameter, value),))


def reference():
    fade = np.clip(np.minimum(T_S, T_S[-1] - T_S), 0.0, 1.0)[:, None]
    return Q_START + fade * 0.05 * np.sin(np.outer(T_S, [1.3, 0.9, 1.1, 1.9, 1.6, 2.2]))


def kernel(effects, sent_s, sent):
    """The same by the kernel that diagnoses are fitted with."""
    plant = actuators_of(MACHINE)
    cycles = round(T_S[-1] / plant.cycle_s) + 1
    return simulate(plant, pack_effects(effects, 6), drive_by_sent(plant, sent_s, sent, 0.0, cycles))


@pytest.mark.parametrize(
    "one",
    [
        effect("valve_deadband", 0.03, 2, "half_width_frac"),
        effect("valve_hysteresis", 0.02, 3, "half_width_frac"),
        effect("valve_lag", 0.05, 1, "time_constant_s"),
        effect("valve_asymmetry", 0.2, 4, "gain_frac"),
        effect("flow_gain_error", -0.2, 2, "gain_frac"),
        effect("controller_gain_error", -0.3, 2, "gain_frac"),
        effect("controller_lag_error", 0.5, 3, "lag_frac"),
        effect("controller_saturation", 0.05, 1, "limit_frac"),
    ],
    ids=lambda one: one.name,
)
def test_each_effect_does_in_the_simulator_what_its_entry_says(plain, one):
    """Two programs, two steps (0.25 and 0.5 ms): they part by a small share of what the effect does."""
    ref = reference()
    sent_s = np.arange(0.0, 4.0, 0.001)
    sent = np.stack([np.interp(sent_s, T_S, column) for column in ref.T], axis=1)
    nominal, expected = (kernel(effects, sent_s, sent).enc[0, : len(T_S)] for effects in ((), (one,)))
    delay_rows = round(MACHINE.transport_delay_s / 0.01)
    received = np.vstack([np.tile(ref[0], (delay_rows, 1)), ref])[: len(ref)]
    made = follow_reference(offline(plain, (one,)), T_S, received, Q_START).q_encoder
    j = one.joint - 1
    did = np.abs(expected - nominal)[:, j].max()
    assert did > 1e-4
    assert np.abs(made - expected[: len(made)])[:, j].max() < 0.1 * did + 3e-5


def test_a_delay_is_seen_from_what_was_sent_only(plain):
    late = EffectEntry("transport_delay", None, (("delay_s", 0.05),))
    ref = reference()
    same = [follow_reference(offline(plain, given), T_S, ref, Q_START).q_encoder for given in ((), (late,))]
    assert np.array_equal(*same)
    on_time, delayed = (follow_sent(offline(plain, given), T_S, T_S, ref, Q_START).q_encoder for given in ((), (late,)))
    assert np.abs(delayed[5:] - on_time[:-5]).max() < 1e-4
    assert np.abs(delayed - on_time).max() > 1e-3


def test_commands_move_the_plant_without_a_controller(plain):
    u = np.zeros((len(T_S), 6))
    u[:, 0] = 0.1
    moved = follow_commands(offline(plain, ()), T_S, u, Q_START).q_encoder
    assert moved[-1, 0] - moved[0, 0] == pytest.approx(0.1 * 0.5 * T_S[-1], rel=0.01)
    assert np.abs(moved[:, 1:] - Q_START[1:]).max() < 3e-5


def test_the_tool_goes_where_bias_and_length_put_it(plain):
    bias = effect("encoder_bias", 0.01, 1, "bias_rad")
    plainly, biased = (at_rest(offline(plain, given), Q_START) for given in ((), (bias,)))
    reach = np.linalg.norm(plainly[:2, 3])
    assert np.linalg.norm(plainly[:3, 3] - biased[:3, 3]) == pytest.approx(0.01 * reach, rel=1e-3)


@pytest.mark.parametrize(("joint", "compliance"), [(2, 3e-7), (2, 2e-6), (3, 2e-6)])
def test_the_arm_sags_by_what_its_entry_says_and_by_nothing_else(plain, joint, compliance):
    sag = effect("gravity_sag", compliance, joint, "compliance_rad_nm")
    expected = tcp_poses(arm_of(MACHINE), pack_effects((sag,), 6), Q_START[None])[0]
    rigid = tcp_poses(arm_of(MACHINE), pack_effects((), 6), Q_START[None])[0]
    assert at_rest(offline(plain, ()), Q_START) == pytest.approx(rigid, abs=3e-4)  # encoder counts
    made = at_rest(offline(plain, (sag,)), Q_START)
    dropped = np.linalg.norm(expected[:3, 3] - rigid[:3, 3])
    assert dropped > 2e-3
    assert np.linalg.norm(made[:3, 3] - expected[:3, 3]) < 0.05 * dropped + 3e-4
    still = follow_reference(offline(plain, (sag,)), T_S[:5], np.tile(Q_START, (5, 1)), Q_START)
    assert still.tcp_poses()[-1] == pytest.approx(made, abs=3e-4)


def test_play_lies_behind_the_encoders_and_begins_in_the_middle(plain):
    play = effect("backlash", 0.02, 1, "width_rad")
    ref = reference()
    runs = [follow_reference(offline(plain, given), T_S, ref, Q_START) for given in ((), (play,))]
    assert np.array_equal(runs[0].q_encoder, runs[1].q_encoder)
    behind = (runs[1].angles - runs[0].angles)[:, MOTOR_JOINT_INDICES]
    assert np.abs(behind[:, 0]).max() == pytest.approx(0.01, abs=1e-4)
    assert behind[0, 0] == 0.0
    assert not behind[:, 1:].any()
    assert at_rest(offline(plain, (play,)), Q_START) == pytest.approx(at_rest(offline(plain, ()), Q_START))


@pytest.mark.parametrize("cycle_s", [0.001, 0.005, 0.02])
def test_the_loop_is_the_same_however_often_the_plc_runs_it(plain, cycle_s):
    slow = plain_world(replace(MACHINE, plc_cycle_s=cycle_s))
    ref = reference()
    made, same = (follow_reference(offline(one, ()), T_S, ref, Q_START).q_encoder for one in (slow, plain))
    assert made == pytest.approx(same, abs=1e-9)


def test_what_the_plant_cannot_have_is_refused(plain):
    droop = EffectEntry("supply_droop", None, (("flow_limit_frac", 0.5),))
    with pytest.raises(PresetError, match="supply_droop cannot be simulated"):
        offline(plain, (droop,))
    shutter = EffectEntry("rolling_shutter", None, (("readout_s", 0.01), ("stamp_row", 0.0)))
    with pytest.raises(PresetError, match="rolling_shutter cannot be simulated"):
        offline(plain, (shutter,))
    with pytest.raises(PresetError, match="6 joints; the machine file has 5"):
        plain_world(replace(MACHINE, joints=MACHINE.joints[:5]))
