"""The sealed generator: its mix, its own kinematics against the file's, its link, its seal, and what it imports."""

import ast
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.diagnosis.sealed import behind, link, motion, own_plant, recorded
from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.arm_effects import ARM_EFFECTS
from benchmarks.diagnosis.sealed.cases import BLOCK, draw, mix_of
from benchmarks.diagnosis.sealed.faults import FOREIGN, Injected, faults_of
from benchmarks.diagnosis.sealed.judge import Equal, SealError, judged, opened
from benchmarks.diagnosis.sealed.limits import key, no_easier_with_less_noise
from benchmarks.diagnosis.sealed.scales import KINDS, NOT_JUDGED
from benchmarks.diagnosis.sealed.sensitivity import separation, size2
from diagnosis.log.nominal import nominal_of
from machine.effects.entries import make_entry, pack_effects
from machine.effects.registry import NAMES, effect_named
from machine.effects.structure import link_poses, tcp_poses

NOMINAL = nominal_of(own.toml())
ROOT = Path(__file__).parents[2]
LIMITS = {key(kind.name, joint): [kind.guess] * 3 for kind in KINDS for joint in kind.joints or (None,)}


def test_every_block_of_twenty_holds_the_whole_mix() -> None:
    for block in range(3):
        mix = Counter(mix_of(20 * block + k, 5) for k in range(20))
        assert mix == Counter(BLOCK)
    assert [mix_of(k, 5) for k in range(20)] != [mix_of(k, 6) for k in range(20)]


def test_every_effect_but_those_that_the_plants_cannot_draw_is_drawn() -> None:
    assert {kind.name for kind in KINDS} == set(NAMES) - set(NOT_JUDGED)
    assert not set(FOREIGN) & set(NAMES)


def test_a_case_is_the_same_again_and_has_sizes_about_the_limit() -> None:
    first, again = (draw(3, 5, LIMITS) for _ in range(2))
    assert first == again
    factors = [one.factor for k in range(60) for one in draw(k, 5, LIMITS).effects if one.factor is not None]
    assert min(factors) >= 0.5
    assert max(factors) <= 8.0
    fixed = [one.factor for k in range(60) for one in draw(k, 5, LIMITS, 1.0).effects if one.factor is not None]
    assert set(fixed) == {1.0}


@pytest.mark.parametrize(("one", "parameters"), ARM_EFFECTS)
def test_the_generators_arm_bends_as_the_catalogue_defines(one: Injected, parameters: dict) -> None:
    q = np.array([0.3, 0.6, -1.5])
    tree_q = np.zeros(11)
    tree_q[behind.MOTOR_JOINT_INDICES] = np.concatenate([q, own.WRIST_RAD])
    structure = behind.structure_of(faults_of((one,), own.N))
    links = behind.link_frames(structure, *behind.bodies_at(structure, tree_q))
    effect = effect_named(one.name)
    assert effect is not None
    assert NOMINAL.arm is not None
    sets = pack_effects([make_entry(effect, one.joint, parameters)], own.N)
    theirs = link_poses(NOMINAL.arm, sets, q[None])[0]
    for number in (2, 3):
        np.testing.assert_allclose(links[number], theirs[number], atol=1e-12)
    np.testing.assert_allclose(links[0], tcp_poses(NOMINAL.arm, sets, q[None])[0], atol=1e-12)


def test_the_link_holds_delays_loses_rounds_and_limits() -> None:
    t_sent = own.SENT_S * np.arange(200) - own.SENT_EARLY_S
    t = own.CYCLE_S * np.arange(380)
    sent = np.repeat((0.2 * np.sin(3.0 * t_sent))[:, None], 3, axis=1)

    def through(*injected: Injected) -> np.ndarray:
        return link.received(faults_of(injected, 3), sent, t_sent, t, 0.0, np.random.default_rng(1))[0]

    plain = through()
    late = through(Injected("transport_delay", None, {"delay_s": 0.05}))
    np.testing.assert_array_equal(late[10:], plain[:-10])
    rounded = through(Injected("reference_quantisation", 2, {"step_rad": 0.01}))
    np.testing.assert_allclose(rounded[:, 1] / 0.01, np.round(rounded[:, 1] / 0.01), atol=1e-9)
    np.testing.assert_array_equal(rounded[:, 0], plain[:, 0])
    slow = through(Injected("reference_rate_limit", 3, {"rate_rad_s": 0.1}))
    assert np.abs(np.diff(slow[:, 2])).max() == pytest.approx(0.1 * own.CYCLE_S)
    lossy = through(Injected("packet_loss", None, {"loss_frac": 0.3}))
    assert 0.05 < float(np.mean(lossy[:, 0] != plain[:, 0])) < 0.5


def test_the_programme_begins_and_ends_each_segment_at_home() -> None:
    ref, pieces = motion.programme(np.random.default_rng(2), own.HOME_RAD, own.SENT_S)
    assert [one.kind for one in pieces].count("repeat") == 4
    first = [ref[round(one.start_s / own.SENT_S) : round(one.end_s / own.SENT_S)] for one in pieces if one.repeat]
    for other in first[1:]:
        np.testing.assert_array_equal(first[0], other)
    for one in pieces:
        np.testing.assert_allclose(ref[round(one.end_s / own.SENT_S)], own.HOME_RAD, atol=1e-12)
    assert np.abs(np.diff(ref, axis=0)).max() / own.SENT_S < 0.4


def test_samples_of_repeats_fall_on_the_same_phase() -> None:
    period = motion.SECONDS + motion.QUIET_S
    for step in (recorded.TRACKER_S, recorded.CAMERA_S):
        assert period / step == pytest.approx(round(period / step))


def test_a_truth_that_was_changed_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sealed").mkdir()
    (tmp_path / "recording").mkdir()
    (tmp_path / "sealed" / "truth.json").write_text("{}", encoding="utf-8")
    (tmp_path / "recording" / "seal.json").write_text(json.dumps({"sha256": "0" * 64}), encoding="utf-8")
    with pytest.raises(SealError, match="void"):
        opened(tmp_path)


def test_separation_is_what_the_other_effect_cannot_take_up() -> None:
    a, b = {"x": np.array([3.0, 4.0])}, {"x": np.array([6.0, 0.0])}
    assert size2(a) == pytest.approx(25.0)
    assert separation(a, b) == pytest.approx(16.0)
    assert separation(a, {"y": np.array([1.0])}) == pytest.approx(25.0)
    assert separation(a, a) == pytest.approx(0.0, abs=1e-12)


def test_what_an_effect_does_by_chance_is_not_counted() -> None:
    rng = np.random.default_rng(1)
    steady, swing = np.full(4000, 0.05), rng.normal(0.0, 0.5, (2, 4000))
    draws = {"x": steady + swing}
    assert size2({"x": steady}) == pytest.approx(10.0)
    assert draws["x"][0] @ draws["x"][0] > 900.0
    assert size2(draws) == pytest.approx(10.0, abs=20.0)
    assert size2({"x": np.array([[1.0, 0.0], [-1.0, 0.0]])}) == 0.0
    assert separation({"x": np.stack([steady, steady])}, {"x": np.stack([steady, steady])}) == pytest.approx(0.0)


def test_a_faulty_machine_is_kept_where_the_other_one_is() -> None:
    seconds = np.arange(0.0, 4.0, own.CYCLE_S)
    ref = own.HOME_RAD + np.outer(0.15 * (1.0 - np.cos(1.5 * seconds)), [1.0, 1.0, -1.0])
    shock = np.zeros_like(ref)
    plain = own_plant.run(faults_of((), own.N), ref, shock)
    fast = faults_of((Injected("flow_gain_error", 2, {"gain_frac": 0.1}),), own.N)
    free, kept = (own_plant.run(fast, ref, shock, plain.u, near) for near in (None, plain.smooth))
    ahead = kept.smooth - plain.smooth
    assert np.abs(ahead[:, 1]).max() > 0.01  # goes on as if nothing had been set
    assert np.abs(kept.tree_q - plain.tree_q).max() < 0.2 * np.abs(free.tree_q - plain.tree_q).max()
    assert np.abs(ahead[:, ::2]).max() < 0.1 * np.abs(ahead[:, 1]).max()
    same = own_plant.run(faults_of((), own.N), ref, shock, plain.u, plain.smooth)
    np.testing.assert_array_equal(same.smooth, plain.smooth)


def test_no_limit_is_larger_beside_less_noise() -> None:
    assert no_easier_with_less_noise([0.7, 0.3, 0.4]) == [0.3, 0.3, 0.4]
    assert no_easier_with_less_noise([0.1, 0.2, None]) == [0.1, 0.2, None]
    assert no_easier_with_less_noise([None, 0.2, 0.3]) == [0.2, 0.2, 0.3]


def answered(verdict: str, *names: tuple[str, int | None]) -> dict:
    status = "confirmed" if verdict == "effects" else "likely"
    fixed = {"stage": "", "parameters": {}, "status": status, "probability": 0.9}
    effects = [{"name": name, "joint": joint, **fixed} for name, joint in names]
    return {
        "verdict": verdict,
        "why": "",
        "hypotheses": [{"effects": effects, "probability": 0.9}],
        "outside_probability": 0.02,
        "credible_set_90": [{"effects": effects, "probability": 0.9}],
        "indistinguishable": [],
        "localisation": [],
        "shrink": {},
        "detection_limits": [],
        "budget": {"effects": effects},
    }


def test_nothing_is_right_only_as_none_and_a_refusal_claims_nothing() -> None:
    truth = {"number": 0, "seed": 1, "mix": "none", "noise": 0, "effects": [], "lacking": ""}
    assert judged(truth, answered("none"), ())["none"]
    wrong = judged(truth, answered("effects", ("valve_lag", 1)), ())
    assert not wrong["none"]
    assert wrong["false"] == [["valve_lag", 1]]
    held = judged(truth, answered("undecided", ("valve_lag", 1)), ())
    assert held["refused"]
    assert held["false"] == []


@pytest.mark.slow
def test_a_name_that_the_scorer_can_tell_apart_is_false(monkeypatch: pytest.MonkeyPatch) -> None:
    effect = {"name": "valve_lag", "joint": 1, "values": {"time_constant_s": 0.1}, "option": "", "direction": []}
    drawn = {"effect": effect, "limit": 0.01, "factor": 10.0, "stage": "actuator"}
    truth = {"number": 0, "seed": 1, "mix": "single", "noise": 0, "effects": [drawn], "lacking": ""}
    number = {"value": 0.1, "low": 0.09, "high": 0.11, "unit": "s"}
    right = answered("effects", ("valve_lag", 1))
    right["budget"]["effects"][0]["parameters"] = {"time_constant_s": number}
    good = judged(truth, right, ())
    assert good["exact"]
    assert good["values"][0]["inside"]
    assert good["closed_true"] == pytest.approx(1.0)
    small = answered("effects", ("flow_gain_error", 1))
    small["budget"]["effects"][0]["parameters"] = {"gain_frac": {**number, "value": 0.01}}
    for T, exact in ((100.0, False), (1.0, True)):
        monkeypatch.setattr(Equal, "separation", lambda _self, _true, _named, T=T: T)
        other = judged(truth, small, ())
        assert other["exact"] is exact
        assert bool(other["false"]) is not exact


def test_what_is_named_for_a_lacking_effect_is_false_and_told_apart_where_it_can_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    effect = {"name": "valve_lag", "joint": 1, "values": {"time_constant_s": 0.1}, "option": "", "direction": []}
    drawn = {"effect": effect, "limit": 0.01, "factor": 10.0, "stage": "actuator"}
    truth = {"number": 0, "seed": 1, "mix": "lacking", "noise": 0, "effects": [drawn], "lacking": "valve_lag"}
    monkeypatch.setattr(Equal, "strength", lambda _self, _true: 10.0)
    for T, twin in ((100.0, False), (1.0, True)):
        monkeypatch.setattr(Equal, "separation", lambda _self, _true, _named, T=T: T)
        found = judged(truth, answered("effects", ("flow_gain_error", 1)), ())
        assert found["false"] == [["flow_gain_error", 1]]
        assert not found["refused"]
        assert found["twin"] is twin
    assert judged(truth, answered("outside"), ())["twin"] is False


def _imported(folder: Path) -> set[str]:
    names: set[str] = set()
    for file in folder.rglob("*.py"):
        if file.name.startswith(("test_", "conftest")):
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {one.name.split(".")[0] for one in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module.split(".")[0])
    return names


def test_generator_and_diagnosis_know_nothing_of_each_other() -> None:
    assert "diagnosis" not in _imported(ROOT / "benchmarks" / "diagnosis" / "sealed")
    assert not {"benchmarks", "sim_plc"} & _imported(ROOT / "diagnosis")
