"""The compiled kernel against the nominal model's definition, a slow reference, and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from effects_cases import drive, hiab, is_dynamic, plant_of_hiab, random_sets, reference
from slow_model import nominal_rows, slow_rows

from machine.effects.dynamics import (
    Actuators,
    DynamicStage,
    SimulatedTraces,
    actuators_of,
    drive_actuator,
    drive_by_sent,
    drive_controller,
    drive_joint,
    simulate,
)
from machine.effects.entries import make_entry, pack_effects
from machine.effects.kernel import FLOW_LIMIT, LOSS
from machine.effects.layout import ParameterSets, neutral_sets, slots_of
from machine.effects.registry import EFFECTS, effect_named
from machine.errors import MachineError

DYNAMIC = [effect for effect in EFFECTS if is_dynamic(effect)]


def packed(name: str, joint: int | None, n: int = 6, **parameters: object):
    effect = effect_named(name)
    assert effect is not None
    return pack_effects([make_entry(effect, joint, parameters)], n)


@pytest.mark.parametrize("delay_s", [0.0, 0.007])
def test_at_neutral_it_is_the_nominal_model_bit_by_bit(delay_s: float) -> None:
    plant = plant_of_hiab(delay_s=delay_s)
    run = drive(plant, loads=True)
    traces = simulate(plant, neutral_sets(6), run)
    us, qs = nominal_rows(plant, run)
    assert np.array_equal(traces.u[0], np.array(us))
    assert np.array_equal(traces.enc[0], np.array(qs))
    assert np.array_equal(traces.link[0], np.array(qs))


def test_a_slow_cycle_is_integrated_in_steps_of_a_millisecond_or_less() -> None:
    fast = actuators_of(hiab())
    plant = Actuators(fast.joints, 0.005, 0.01, 0.0)
    assert plant.substeps == 5
    run = drive(plant)
    us, qs = nominal_rows(plant, run)
    traces = simulate(plant, neutral_sets(6), run)
    assert np.array_equal(traces.u[0], np.array(us))
    assert np.array_equal(traces.enc[0], np.array(qs))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_joint_by_itself_moves_as_it_does_among_all(seed: int) -> None:
    """Run alone it goes through a loop of its own."""
    plant, loss = plant_of_hiab(delay_s=0.0035), 0.2 * (seed - 1)
    run, sets = drive(plant, 0.8, loads=True), random_sets(6, 2, seed, share=0.4)
    sets.machine_parameters[:, LOSS] = loss
    found = []
    for limit in (1e9, np.inf):  # a pump that never lacks, and none to share
        sets.machine_parameters[:, FLOW_LIMIT] = limit
        found.append(simulate(plant, sets, run))
    shared, among = found
    for name in ("ref", "u", "enc", "link"):
        assert np.array_equal(getattr(shared, name), getattr(among, name)), name
    signals = ("sent", "ref", "enc", "u", "load", "load_kg")
    for j in range(6):
        columns = {name: getattr(run, name)[:, j : j + 1].copy() for name in signals}
        starts = {name: getattr(run, name)[j : j + 1].copy() for name in ("enc_start", "u_start")}
        own = ParameterSets(sets.joint_parameters[:, j : j + 1].copy(), sets.machine_parameters)
        alone = simulate(replace(plant, joints=plant.joints[j : j + 1]), own, replace(run, **columns, **starts))
        for name in ("ref", "u", "enc", "link"):
            assert np.array_equal(getattr(alone, name)[..., 0], getattr(among, name)[..., j]), (name, j)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_all_terms_at_once_equal_the_slow_reference(seed: int) -> None:
    plant = plant_of_hiab(delay_s=0.003)
    run = drive(plant, 0.8, loads=True)
    sets = random_sets(6, 1, seed, share=0.4)
    fast = simulate(plant, sets, run)
    slow = slow_rows(plant, sets.joint_parameters[0], sets.machine_parameters[0], run)
    for name in ("ref", "u", "enc", "link"):
        assert getattr(fast, name)[0] == pytest.approx(slow[name], abs=1e-9), name
    assert np.ptp(fast.enc[0], axis=0).min() > 1e-3  # it moved


@pytest.mark.parametrize("effect", DYNAMIC, ids=lambda effect: effect.name)
def test_each_effect_with_neutral_size_is_an_exact_identity(effect) -> None:
    plant = plant_of_hiab()
    run = drive(plant, loads=True)
    shapes = {parameter.name: parameter.start_value for parameter in effect.shapes}
    entry = make_entry(
        effect, None if effect.scope == "machine" else 2, {effect.size.name: effect.size.neutral_value, **shapes}
    )
    nominal, neutral = simulate(plant, neutral_sets(6), run), simulate(plant, pack_effects([entry], 6), run)
    for name in ("ref", "u", "enc", "link"):
        assert np.array_equal(getattr(nominal, name), getattr(neutral, name)), name


@pytest.mark.parametrize("effect", DYNAMIC, ids=lambda effect: effect.name)
def test_each_parameter_moves_the_output(effect) -> None:
    """Round the start, so that a fit that begins there has a slope. The load's own terms need leakage to be seen."""
    plant = plant_of_hiab()
    run = drive(plant, loads=True)
    base = packed("internal_leakage", 2, drift_rad_s=0.01) if effect.name == "payload_error" else neutral_sets(6)
    slots = slots_of(effect.name, None if effect.scope == "machine" else 2)
    for slot in slots:
        base.put(slot, slot.start_value)
    for slot in slots:
        moved = base.repeated_sets(2)
        further = slot.start_value + (
            1.0 if slot.parameter == "order" else 0.05 * (min(slot.typical_max, 2.0) - slot.lower_bound)
        )
        moved.put(slot, further, 1)
        traces = simulate(plant, moved, run)
        change = max(float(np.abs(one[1] - one[0]).max()) for one in (traces.ref, traces.u, traces.enc, traces.link))
        assert change > 1e-7, slot.parameter


def test_finite_anywhere_inside_the_bounds() -> None:
    plant = plant_of_hiab()
    traces = simulate(plant, random_sets(6, 100, seed=7), drive(plant, loads=True))
    for values in (traces.ref, traces.u, traces.enc, traces.link):
        assert np.isfinite(values).all()
    slow = Actuators(plant.joints, 0.01, 0.01, 0.0)
    assert np.isfinite(simulate(slow, random_sets(6, 100, seed=8), drive(slow, loads=True)).link).all()


def test_sets_do_not_touch_each_other() -> None:
    plant = plant_of_hiab()
    run = drive(plant, 1.0, loads=True)
    many = random_sets(6, 5, seed=3)
    together = simulate(plant, many, run)
    for s in range(5):
        alone = type(many)(many.joint_parameters[s : s + 1].copy(), many.machine_parameters[s : s + 1].copy())
        assert np.array_equal(simulate(plant, alone, run).link[0], together.link[s])


def test_a_fractional_delay_lies_between_its_neighbours_and_a_whole_one_is_a_shift() -> None:
    plant = plant_of_hiab(log_cycle_s=0.001)
    run = drive(plant, 1.0)
    delayed = {
        d: simulate(plant, packed("transport_delay", None, delay_s=d), run).ref[0] for d in (0.0, 0.02, 0.0205, 0.021)
    }
    assert np.array_equal(delayed[0.02][20:], delayed[0.0][:-20])
    assert delayed[0.0205] == pytest.approx(0.5 * (delayed[0.02] + delayed[0.021]), abs=1e-12)


def constant_command(plant: Actuators, u: float, duration_s: float, load: float = 0.0):
    rows = round(duration_s / plant.log_cycle_s)
    loads = np.full((rows, plant.n), load), np.zeros((rows, plant.n))
    run = drive_actuator(plant, np.full((rows, plant.n), u), np.zeros(plant.n), loads)
    return run, np.arange(rows) * plant.log_cycle_s


def speed(plant: Actuators, sets, u: float, load: float = 0.0) -> np.ndarray:
    run, t = constant_command(plant, u, 2.0, load)
    enc = simulate(plant, sets, run, DynamicStage.ACTUATOR).enc[0]
    return (enc[-1] - enc[-101]) / (t[-1] - t[-101])


def test_steady_speeds_are_those_of_the_formulas() -> None:
    plant = plant_of_hiab()
    kv = plant.joints[:, 0]
    assert speed(plant, neutral_sets(6), 0.5) == pytest.approx(0.5 * kv)
    assert speed(plant, packed("valve_deadband", 2, half_width_frac=0.1), 0.05)[1] == 0.0
    assert speed(plant, packed("valve_deadband", 2, half_width_frac=0.1), -0.55)[1] == pytest.approx(-0.5 * kv[1])
    assert speed(plant, packed("flow_gain_error", 2, gain_frac=0.2), -0.5)[1] == pytest.approx(-0.6 * kv[1])
    assert speed(plant, packed("valve_asymmetry", 2, gain_frac=0.2), -0.5)[1] == pytest.approx(-0.5 * kv[1])
    assert speed(plant, packed("valve_asymmetry", 2, gain_frac=0.2), 0.5)[1] == pytest.approx(0.6 * kv[1])
    assert speed(plant, packed("load_droop", 2, droop_frac=0.4), 0.5, -0.5)[1] == pytest.approx(0.4 * kv[1])
    assert speed(plant, packed("load_droop", 2, droop_frac=0.4), -0.5, -0.5)[1] == pytest.approx(-0.6 * kv[1])
    assert speed(plant, packed("internal_leakage", 2, drift_rad_s=0.01), 0.0, -0.5)[1] == pytest.approx(-0.005)
    assert speed(plant, packed("supply_droop", None, flow_limit_frac=1.2), 0.5) == pytest.approx(0.5 * kv * 1.2 / 3.0)


def test_stiction_holds_until_its_command_and_then_runs_on_below_it() -> None:
    plant = plant_of_hiab()
    sets = packed("stiction", 2, breakaway_frac=0.1)
    ramp = np.concatenate([np.linspace(0.0, 0.15, 200), np.linspace(0.15, 0.0, 200)])
    enc = simulate(
        plant, sets, drive_actuator(plant, np.tile(ramp[:, None], 6), np.zeros(6)), DynamicStage.ACTUATOR
    ).enc[0, :, 1]
    started = ramp[np.argmax(np.diff(enc) > 0.0)]
    ended = ramp[399 - np.argmax(np.diff(enc)[::-1] > 0.0)]
    assert started == pytest.approx(0.1, abs=0.003)
    assert ended == pytest.approx(0.02, abs=0.004)


def test_the_spool_follows_with_play_and_with_lag() -> None:
    plant = plant_of_hiab(log_cycle_s=0.001)
    t = np.arange(4000) * 1e-3
    u = np.tile(0.3 * np.sin(2.0 * np.pi * 0.5 * t)[:, None], 6)

    def travel(sets):
        return np.diff(simulate(plant, sets, drive_actuator(plant, u, np.zeros(6)), DynamicStage.ACTUATOR).enc[0, :, 1])

    nominal, play = travel(neutral_sets(6)), travel(packed("valve_hysteresis", 2, half_width_frac=0.05))
    assert play.max() / nominal.max() == pytest.approx(0.25 / 0.3, rel=0.01)
    lagged = travel(packed("valve_lag", 2, time_constant_s=0.2))
    w = 2.0 * np.pi * 0.5
    assert lagged[2000:].max() / nominal[2000:].max() == pytest.approx(1.0 / np.hypot(1.0, 0.2 * w), rel=0.01)


def test_controller_replay_is_gain_lag_and_clip() -> None:
    plant = plant_of_hiab()
    ref, enc = np.zeros((300, 6)), np.zeros((300, 6))
    ref[:, :] = 0.1
    run = drive_controller(plant, ref, enc, np.zeros(6))
    kp = plant.joints[:, 3]

    def u(sets):
        return simulate(plant, sets, run, DynamicStage.CONTROLLER).u[0]

    assert u(neutral_sets(6))[-1] == pytest.approx(0.1 * kp)
    assert u(packed("controller_gain_error", 2, gain_frac=0.3))[-1, 1] == pytest.approx(0.13 * kp[1])
    assert u(packed("controller_saturation", 2, limit_frac=0.2))[-1, 1] == 0.2
    lagged = u(packed("controller_lag_error", 2, lag_frac=1.0))[:, 1] / (0.1 * kp[1])
    assert lagged[20] == pytest.approx(1.0 - np.exp(-0.201 / 0.2), abs=1e-9)


def test_replay_from_measured_inputs_repeats_the_closed_loop() -> None:
    """Logged every cycle, the replay of each stage by its own input is the stage itself."""
    plant = plant_of_hiab(log_cycle_s=0.001)
    sets = random_sets(6, 1, seed=5, share=0.2)
    run = drive(plant, 1.0)
    whole = simulate(plant, sets, run)
    u = simulate(
        plant, sets, drive_controller(plant, whole.ref[0], whole.enc[0], np.zeros(6)), DynamicStage.CONTROLLER
    ).u
    enc = simulate(plant, sets, drive_actuator(plant, whole.u[0], whole.enc[0, 0]), DynamicStage.ACTUATOR).enc
    link = simulate(plant, sets, drive_joint(plant, whole.enc[0])).link
    assert u == pytest.approx(whole.u, abs=1e-9)
    assert np.abs(enc[0] - whole.enc[0]).max() < 2e-3  # a replay starts at rest, its first command is held before
    assert link == pytest.approx(whole.link, abs=1e-9)


def test_backlash_and_flexibility_stand_behind_the_encoder() -> None:
    plant = plant_of_hiab()
    t = np.arange(600) * 0.01
    enc = np.tile(0.2 * np.sin(2.0 * np.pi * 0.5 * t)[:, None], 6)
    link = simulate(plant, packed("backlash", 2, width_rad=0.02), drive_joint(plant, enc)).link[0, :, 1]
    assert np.ptp((enc[:, 1] - link)[200:]) == pytest.approx(0.02, abs=1e-6)
    step = np.tile(np.clip(t - 1.0, 0.0, 1.0)[:, None], 6)  # starts and stops at 1 rad/s
    swung = simulate(
        plant, packed("link_flexibility", 2, gain=0.5, frequency_hz=2.0, damping=0.05), drive_joint(plant, step)
    )
    bend = swung.link[0, :, 1] - step[:, 1]
    w = 2.0 * np.pi * 2.0
    wd = w * np.sqrt(1.0 - 0.05**2)
    tau = t[101:199] - 1.0
    assert bend[101:199] == pytest.approx(-0.5 / wd * np.exp(-0.05 * w * tau) * np.sin(wd * tau), abs=2e-3)


def test_two_swings_of_a_joint_go_on_beside_each_other() -> None:
    plant, effect = plant_of_hiab(), effect_named("link_flexibility")
    assert effect is not None
    t = np.arange(600) * 0.01
    enc = np.tile(0.2 * np.sin(2.0 * np.pi * 0.5 * t)[:, None], 6)

    def bend(*swings: tuple[float, float]) -> np.ndarray:
        entries = [make_entry(effect, 2, {"gain": gain, "frequency_hz": hz}) for gain, hz in swings]
        return simulate(plant, pack_effects(entries, 6), drive_joint(plant, enc)).link[0, :, 1] - enc[:, 1]

    one, other = (0.9, 3.8), (0.2, 2.1)
    assert np.abs(bend(other)).max() > 1e-4
    assert bend(one, other) == pytest.approx(bend(one) + bend(other), abs=1e-12)


def test_lost_datagrams_are_a_share_and_the_same_for_all_joints() -> None:
    plant = Actuators(plant_of_hiab().joints, 0.001, 0.001, 0.0)
    t = np.arange(5000) * 1e-3
    sent = np.tile(t[:, None], 6)
    ref = simulate(
        plant, packed("packet_loss", None, loss_frac=0.2), drive_by_sent(plant, t, sent, 0.0, 5000), DynamicStage.LINK
    ).ref[0]
    held = np.diff(ref, axis=0) == 0.0
    assert 0.17 < held[:, 0].mean() < 0.23
    assert (held == held[:, :1]).all()


@pytest.mark.parametrize(("cycle_s", "delay_s"), [(0.004, 0.006), (0.002, 0.005), (0.01, 0.002), (0.004, 0.008)])
def test_a_nominal_delay_of_part_of_a_cycle_waits_for_the_next_one(cycle_s: float, delay_s: float) -> None:
    """The definition by hand: at each tick the last reference that was sent a delay ago, or longer."""
    plant = Actuators(plant_of_hiab().joints, cycle_s, cycle_s, delay_s)
    rng, count = np.random.default_rng(6), 300
    t = 0.01 * np.arange(count) + rng.uniform(0.0, 2e-3, count)
    sent = reference(t)
    cycles = round(t[-1] / cycle_s)
    ref = simulate(plant, neutral_sets(6), drive_by_sent(plant, t, sent, 0.0, cycles), DynamicStage.LINK).ref[0]
    ticks = cycle_s * np.arange(cycles)
    there = [max(0, int((t + delay_s <= tick + 1e-9).sum()) - 1) for tick in ticks]
    late = round(0.05 / cycle_s)
    assert np.array_equal(ref[late:], sent[there][late:])


def test_a_link_is_the_same_in_seconds_since_1970() -> None:
    """Where the delay is whole cycles a datagram is due at a tick, and such seconds are known to 0.24 us."""
    plant = Actuators(plant_of_hiab().joints, 0.01, 0.01, 0.02)
    t = 0.01 * np.arange(300)
    sent = reference(t)
    refs = [
        simulate(
            plant,
            neutral_sets(6),
            drive_by_sent(plant, np.round(start_s + t, 6), sent, np.round(start_s + 0.37, 6), 250),
            DynamicStage.LINK,
        ).ref[0]
        for start_s in (0.0, 1.772e9, 1.772000123e9)
    ]
    assert np.array_equal(refs[0], refs[1])
    assert np.array_equal(refs[0], refs[2])


def test_rounding_and_rate_limit_of_the_reference() -> None:
    plant = plant_of_hiab(log_cycle_s=0.001)
    run = drive(plant, 1.0)
    stairs = simulate(plant, packed("reference_quantisation", 2, step_rad=0.004), run, DynamicStage.LINK).ref[0]
    assert stairs[:, 1] / 0.004 == pytest.approx(np.round(stairs[:, 1] / 0.004), abs=1e-9)
    slow = simulate(plant, packed("reference_rate_limit", 2, rate_rad_s=0.1), run, DynamicStage.LINK).ref[0]
    assert np.abs(np.diff(slow[:, 1])).max() <= 0.1e-3 * (1 + 1e-9)
    assert np.array_equal(slow[:, 0], simulate(plant, neutral_sets(6), run, DynamicStage.LINK).ref[0][:, 0])


def test_the_encoder_starts_at_the_reference_whatever_its_error() -> None:
    plant = plant_of_hiab()
    sets = random_sets(6, 4, seed=11)
    traces: SimulatedTraces = simulate(plant, sets, drive(plant, 0.5))
    assert traces.enc[:, 0] == pytest.approx(np.tile(reference(np.zeros(1)), (4, 1)), abs=1e-12)


def test_wrong_shapes_are_refused_with_the_shape_wanted() -> None:
    plant = plant_of_hiab()
    with pytest.raises(MachineError, match=r"finite \(rows, 6\)"):
        drive_joint(plant, np.zeros((10, 5)))
    with pytest.raises(MachineError, match="rising"):
        drive_by_sent(plant, np.array([0.0, -1.0]), np.zeros((2, 6)), 0.0, 10)
    for times in (np.array([0.0, np.nan]), np.array([0.0, np.inf])):
        with pytest.raises(MachineError, match="rising"):
            drive_by_sent(plant, times, np.zeros((2, 6)), 0.0, 10)
    still = np.zeros((2, 6))
    with pytest.raises(MachineError, match=r"lost of shape \(1,\); give one cycle or more, and one word each"):
        drive_by_sent(plant, np.array([0.0, 1.0]), still, 0.0, 10, lost=np.array([True]))
    with pytest.raises(MachineError, match="0 PLC cycles"):
        drive_by_sent(plant, np.array([0.0, 1.0]), still, 0.0, 0)
    with pytest.raises(MachineError, match=r"encoders at the start has shape \(2,\); the plant has 6 joints"):
        drive_actuator(plant, still, np.zeros(2))
    with pytest.raises(MachineError, match=r"first valve command has shape \(1,\)"):
        drive_controller(plant, still, still, np.zeros(1))
    with pytest.raises(MachineError, match="6 joints"):
        simulate(plant, neutral_sets(5), drive(plant, 0.1))
    with pytest.raises(MachineError, match="cannot begin"):
        simulate(plant, neutral_sets(6), drive_joint(plant, np.zeros((10, 6))), DynamicStage.LINK)
    with pytest.raises(MachineError, match="needs the encoders"):
        simulate(plant, neutral_sets(6), drive(plant, 0.1), DynamicStage.CONTROLLER)
    with pytest.raises(MachineError, match="multiple"):
        Actuators(plant.joints, 0.001, 0.0015, 0.0)


@pytest.mark.parametrize("damping", [0.3, 1.0, 1.5, 4.5, 10.0])
@pytest.mark.parametrize("frequency_hz", [5.0, 40.0, 200.0])
def test_a_valve_of_any_damping_settles_at_its_speed(frequency_hz: float, damping: float) -> None:
    joints = np.array([[0.5, 2.0 * np.pi * frequency_hz, damping, 4.0, 0.0]])
    for cycle_s in (0.001, 0.01):
        plant = Actuators(joints, cycle_s, 0.01, 0.0)
        u = np.full((round(6.0 / 0.01), 1), 0.5)
        enc = simulate(plant, neutral_sets(1), drive_actuator(plant, u, np.zeros(1))).enc[0, :, 0]
        assert np.isfinite(enc).all()
        assert (enc[-1] - enc[-101]) / 1.0 == pytest.approx(0.25, rel=0.05)


def test_friction_is_lost_at_each_reversal_and_the_oil_rings_at_its_period() -> None:
    plant = plant_of_hiab(log_cycle_s=0.001)
    t = np.arange(8000) * 1e-3
    there_and_back = np.where(t < 4.0, 0.2, -0.2)

    def run(sets, u):
        return simulate(
            plant, sets, drive_actuator(plant, np.tile(u[:, None], 6), np.zeros(6)), DynamicStage.ACTUATOR
        ).enc[0, :, 1]

    plain = run(neutral_sets(6), there_and_back)
    stiff = run(packed("joint_friction", 2, compression_rad=2e-3), there_and_back)
    assert plain[3999] - stiff[3999] == pytest.approx(2e-3)
    assert stiff[-1] - plain[-1] == pytest.approx(2e-3)
    step = np.where(t < 1.0, 0.0, 0.2)
    off = run(packed("oil_compliance", 2, period_s=0.08, damping=0.05), step) - run(neutral_sets(6), step)
    crossings = np.nonzero(np.diff(np.sign(np.gradient(off[1100:2500]))))[0]
    assert 2.0 * np.median(np.diff(crossings)) * 1e-3 == pytest.approx(2.0 * np.pi * 0.08, rel=0.05)
    assert -np.mean(off[-2011:]) == pytest.approx(2.0 * 0.05 * 0.08 * 0.2 * plant.joints[1, 0], rel=0.1)
