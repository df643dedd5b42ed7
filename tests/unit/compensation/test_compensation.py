"""A diagnosed machine in the server: where the tool is, where to plan for, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from machine.chain import chain_of
from machine.effects.entries import EffectEntry, entries_to_toml, make_entry
from machine.effects.registry import effect_named
from machine.inverse import inverse_nearest
from machine.kinematics import tcp_pose
from machine.poses import inverse_pose, pose
from server.calibration.kinematic_errors import error_model
from server.compensation.compensation import CompensationError, compensation_of
from server.compensation.reading import compensation_from, read_compensation
from server.jobs.context import PlanContext
from server.jobs.knowledge import Knowledge
from server.jobs.plans.diagnosed import goal_from_look
from server.jobs.plans.learning import side_at_goal
from server.settings import ServerSettings, read_machine, read_machine_text
from sim_plc.diagnosed import with_effects
from sim_plc.draw_world import draw_world
from sim_plc.presets import PresetError

MACHINE = read_machine("hiab033")
CHAIN = chain_of(MACHINE)
Q = np.array([0.3, 0.5, -1.0, 0.2, -0.8, -0.1])


def entry(name: str, joint: int | None, **parameters: object) -> EffectEntry:
    effect = effect_named(name)
    assert effect is not None
    return make_entry(effect, joint, parameters)


SEVERAL = (
    entry("gravity_sag", 2, compliance_rad_nm=1e-6),
    entry("encoder_bias", 3, bias_rad=0.004),
    entry("link_length_error", 2, error_m=0.003, of="a"),
    entry("backlash", 1, width_rad=0.002),
)


def test_no_effect_is_the_nominal_machine():
    known = compensation_of(MACHINE, ())
    assert np.allclose(known.tcp_poses(Q[None], np.ones(6))[0], tcp_pose(CHAIN, Q), atol=1e-12)
    assert np.allclose(known.nominal_goal(CHAIN, Q, tcp_pose(CHAIN, Q), np.ones(6)), tcp_pose(CHAIN, Q), atol=1e-12)


def test_the_diagnosed_machine_stands_at_the_goal_when_the_planner_gets_the_nominal_one():
    known = compensation_of(MACHINE, SEVERAL)
    here = known.tcp_poses(Q[None], np.ones(6))[0]
    T_goal = pose(here[:3, :3], here[:3, 3] + np.array([0.1, -0.15, 0.2]))
    q_goal = inverse_nearest(CHAIN, known.nominal_goal(CHAIN, Q, T_goal, np.ones(6)), Q).q_rad
    assert q_goal is not None
    there = known.tcp_poses(q_goal[None], np.ones(6))[0]
    assert np.linalg.norm(there[:3, 3] - T_goal[:3, 3]) < 2e-6
    assert np.linalg.norm(tcp_pose(CHAIN, q_goal)[:3, 3] - T_goal[:3, 3]) > 2e-3


def test_play_lies_behind_on_the_side_it_came_from():
    known = compensation_of(MACHINE, (entry("backlash", 1, width_rad=0.004),))
    up, down = (known.tcp_poses(Q[None], side * np.ones(6))[0] for side in (1.0, -1.0))
    assert np.allclose(up, tcp_pose(CHAIN, Q - np.array([0.002, 0, 0, 0, 0, 0])), atol=1e-9)
    assert np.allclose(down, tcp_pose(CHAIN, Q + np.array([0.002, 0, 0, 0, 0, 0])), atol=1e-9)


def test_a_diagnosed_dead_band_is_the_first_stall_of_its_joint_only():
    known = compensation_of(MACHINE, (entry("valve_deadband", 2, half_width_frac=0.03),))
    stall = known.first_stall(np.full(6, 0.005))
    assert stall[1] == pytest.approx(0.03 / MACHINE.joints[1].kp_frac_per_rad)
    assert (stall[[0, 2, 3, 4, 5]] == 0.005).all()


def test_the_joint_estimate_starts_from_diagnosed_numbers():
    known = compensation_of(MACHINE, SEVERAL)
    believed, prior = known.believed_machine(), known.joint_prior()
    assert believed.joints[2].theta_offset_rad == pytest.approx(MACHINE.joints[2].theta_offset_rad - 0.004)
    assert prior.kinematic_errors.mean_compliance[1] == pytest.approx(1e-6)
    assert prior.kinematic_errors.mean_play_rad[0] == pytest.approx(0.002)
    assert prior.kinematic_errors.sigma_play_rad[0] < 4.5e-4


def test_what_cannot_be_compensated_is_said():
    known = compensation_of(MACHINE, (entry("valve_lag", 2, time_constant_s=0.05), *SEVERAL))
    lines = known.effects_by_use.lines()
    assert "valve_lag, joint 2: not compensated" in lines
    assert "gravity_sag, joint 2: kinematics" in lines


def test_what_the_learnt_map_has_no_number_for_is_told_as_such():
    plain = error_model(MACHINE)
    for name, joint, more in (
        ("gravity_sag", 1, {"compliance_rad_nm": 1e-6}),
        ("gravity_sag", 5, {"compliance_rad_nm": 1e-6}),
        ("encoder_scale", 2, {"scale_frac": 0.01}),
        ("payload_error", None, {"mass_kg": 20.0}),
        ("backlash", 2, {"width_rad": 0.004}),
        ("backlash", 4, {"width_rad": 0.004}),
    ):
        known = compensation_of(MACHINE, (entry(name, joint, **more),))
        found = error_model(known.believed_machine(), known.believed_errors())
        changed = found.n != plain.n or not np.allclose(found.prior_mean, plain.prior_mean)
        (line,) = known.effects_by_use.lines()
        assert changed is not any(word in line for word in ("until a calibration", "not compensated")), line


def test_a_file_of_a_sister_crane_or_of_another_geometry_is_refused(tmp_path):
    path = machine_file(tmp_path, "effects")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[machine]", "[machine]\nserial = 'B-2'", 1), encoding="utf-8")
    with pytest.raises(CompensationError, match=r"serial 'B-2'; the server drives 'A-1'"):
        read_compensation(replace(MACHINE, serial="A-1"), path)
    assert read_compensation(MACHINE, path).effects_by_use.compensated
    longer = replace(MACHINE.joints[1], a_m=MACHINE.joints[1].a_m + 0.01)
    other = replace(MACHINE, joints=(MACHINE.joints[0], longer, *MACHINE.joints[2:]))
    with pytest.raises(CompensationError, match="a_m of joint 'lift'"):
        read_compensation(other, path)
    moved = MACHINE.T_flange_tcp.copy()
    moved[0, 3] += 0.3
    with pytest.raises(CompensationError, match="T_flange_tcp is not that of the server's machine file"):
        read_compensation(replace(MACHINE, T_flange_tcp=moved), path)
    with pytest.raises(CompensationError, match="gravity_base_m_s2 is not that"):
        read_compensation(replace(MACHINE, gravity_base_m_s2=np.array([0.0, -3.0, -9.3])), path)
    mount = MACHINE.T_tcp_cam_left.copy()
    mount[0, 3] += 0.05
    remounted = replace(MACHINE, T_tcp_cam_left=mount)
    assert read_compensation(remounted, path).effects_by_use.compensated  # nothing of the camera was diagnosed
    turned = machine_file(tmp_path, "effects", (entry("hand_eye_rotation", None, angle_rad=0.02),))
    with pytest.raises(CompensationError, match="T_tcp_cam_left is not that"):
        read_compensation(remounted, turned)


def machine_file(tmp_path, verdict: str, effects: tuple[EffectEntry, ...] = SEVERAL):
    path = tmp_path / "diagnosed.toml"
    head = f"\n# longreach diagnose: verdict {verdict}, probability 0.9\n"
    path.write_text(read_machine_text("hiab033") + head + entries_to_toml(effects), encoding="utf-8")
    return path


def test_off_by_default():
    assert compensation_from(ServerSettings(), MACHINE) is None


def test_a_diagnosed_file_is_read(tmp_path):
    settings = ServerSettings.model_validate({"compensation": {"machine_file": str(machine_file(tmp_path, "effects"))}})
    known = compensation_from(settings, MACHINE)
    assert known is not None
    assert [effect.name for effect in known.effects_by_use.compensated] == [effect.name for effect in SEVERAL]


@pytest.mark.parametrize("word", ["undecided", "outside"])
def test_an_unsettled_diagnosis_is_refused(tmp_path, word):
    with pytest.raises(CompensationError, match=f"diagnosis is '{word}' and must not be compensated"):
        read_compensation(MACHINE, machine_file(tmp_path, word))


def test_an_unsettled_answer_beside_the_file_is_refused(tmp_path):
    answer = tmp_path / "answer.json"
    answer.write_text(json.dumps({"verdict": "outside"}), encoding="utf-8")
    with pytest.raises(CompensationError, match="must not be compensated"):
        read_compensation(MACHINE, machine_file(tmp_path, "effects"), answer)


def test_a_file_without_effects_or_of_another_machine_is_refused(tmp_path):
    with pytest.raises(CompensationError, match="nothing to compensate"):
        read_compensation(MACHINE, machine_file(tmp_path, "none", ()))
    with pytest.raises(CompensationError, match="the server drives 'another'"):
        read_compensation(replace(MACHINE, name="another"), machine_file(tmp_path, "effects"))


def test_the_simulator_makes_a_files_effects_true():
    plain = draw_world(MACHINE, "realistic", 1)
    effects = (entry("encoder_bias", 3, bias_rad=0.004), entry("valve_deadband", 2, half_width_frac=0.02))
    changed = with_effects(replace(plain, nominal=replace(MACHINE, effects=effects)))
    zeros = changed.plant.kinematics.theta_zero_rad - plain.plant.kinematics.theta_zero_rad
    assert zeros == pytest.approx([0.0, 0.0, -0.004, 0.0, 0.0, 0.0])
    dead = changed.plant.valve.dead_band_frac - plain.plant.valve.dead_band_frac
    assert dead == pytest.approx([0.0, 0.02, 0.0, 0.0, 0.0, 0.0])


def test_an_effect_that_the_plant_cannot_have_is_refused():
    world = draw_world(MACHINE, "realistic", 1)
    effects = (entry("valve_lag", 2, time_constant_s=0.05),)
    with pytest.raises(PresetError, match="valve_lag cannot be simulated"):
        with_effects(replace(world, nominal=replace(MACHINE, effects=effects)))


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_moves_by_a_diagnosed_play_come_to_their_goal_whoever_follows_it(joint):
    """The side at the look and the side at the goal go by one convention: else half of the play stays for ever."""
    ctx = PlanContext(MACHINE, CHAIN, ServerSettings(), Knowledge())
    play = entry("backlash", joint, width_rad=0.004)
    known = compensation_of(MACHINE, (play,))
    ctx = replace(ctx, compensation=known)
    q, R = Q.copy(), MACHINE.T_tcp_cam_left[:3, :3]
    T_tool = MACHINE.T_tcp_tool
    T_goal = tcp_pose(CHAIN, Q + 0.05)
    T_base_ooi = T_goal @ T_tool @ inverse_pose(ctx.T_ooi_goal)
    for _ in range(3):
        here = known.tcp_poses(q[None], np.ones(6))[0]  # where it stands, having come from below
        T_base_cam = here @ MACHINE.T_tcp_cam_left
        ctx.knowledge.backlash_sides = side_at_goal(ctx)
        seen = inverse_pose(T_base_cam) @ here @ T_tool, inverse_pose(T_base_cam) @ T_base_ooi
        q = inverse_nearest(CHAIN, goal_from_look(ctx, q, R, *seen), q).q_rad
    there = known.tcp_poses(q[None], np.ones(6))[0]
    assert np.linalg.norm(there[:3, 3] - T_goal[:3, 3]) < 1e-4
