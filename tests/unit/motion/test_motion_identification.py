"""Motions and postures that identify a machine: inside every limit, and worth their time."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from machine.chain import chain_of
from machine.description import parse_machine_toml
from machine.kinematics import tcp_pose
from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from server.motion.calibration_paths import markers_in_view
from server.motion.contracts import JointTrajectory, Wall
from server.motion.identification_courses import PARTS, fitted_course, part_course, part_marks
from server.motion.identification_postures import SeenObject, choose_postures
from server.motion.settings import PlanSettings
from server.motion.timing import limit_excess
from server.motion.wall_clearance import clearances

MACHINE = parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))
CHAIN = chain_of(MACHINE)
HOME = np.deg2rad([10.0, 42.0, -85.0, 4.0, -43.0, 3.0])
SETTINGS = replace(PlanSettings(), shape_reference=False, limit_share=0.8)
FOUR = replace(MACHINE, joints=MACHINE.joints[:4], T_flange_tcp=np.eye(4))


def in_front(chain, q_home, away_m=0.65):
    T_ooi_tool = pose(rotation_from_rotvec(np.deg2rad([4.0, -3.0, 5.0])), np.array([0.08, -0.05, away_m]))
    T_base_ooi = tcp_pose(chain, q_home) @ MACHINE.T_tcp_tool @ inverse_pose(T_ooi_tool)
    return SeenObject(T_base_ooi, MACHINE.markers_on("ooi"), MACHINE.T_tcp_cam_left), T_base_ooi


@pytest.mark.parametrize("machine", [MACHINE, FOUR], ids=["six joints", "four joints"])
@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_every_part_is_inside_all_limits_and_comes_back_to_rest(machine, part):
    chain = chain_of(machine)
    home = HOME[: chain.n]
    driven = fitted_course(machine, chain, part_course(machine, chain, part, home, SETTINGS), SETTINGS)
    assert isinstance(driven, JointTrajectory)
    assert limit_excess(machine, chain, driven, SETTINGS, SETTINGS.limit_share).time_factor <= 1.0
    for end in (0, -1):
        assert np.allclose(driven.q[end], home, atol=1e-9)
        assert not driven.qd[end].any()
    moved = np.ptp(driven.q, axis=0)
    assert (moved > np.deg2rad(0.3)).all() if part.kind != "hold" else not moved.any()
    assert part_marks(part)[-1].end_s == pytest.approx(driven.duration_s, abs=1e-6)


def test_repeats_are_the_same_motion_to_a_rounding_however_often_it_is_sampled():
    (part,) = (one for one in PARTS if one.repeats > 1)
    course = part_course(MACHINE, CHAIN, part, HOME, SETTINGS)
    fitted = fitted_course(MACHINE, CHAIN, course, SETTINGS)
    assert isinstance(fitted, JointTrajectory)
    marks = part_marks(part)
    assert len(marks) == 4
    assert {one.repeat_of for one in marks} == {part.name}
    once = np.searchsorted(fitted.t_s, marks[1].start_s - 1e-9)
    for k in range(1, 4):
        again = fitted.q[k * once : (k + 1) * once]
        assert np.allclose(again, fitted.q[:once], atol=1e-12)


def test_postures_see_a_marker_keep_off_the_wall_and_say_what_stays_open():
    seen, T_base_ooi = in_front(CHAIN, HOME)
    wall = Wall(T_base_ooi[:3, 3], T_base_ooi[:3, 2], 0.05)
    found = choose_postures(MACHINE, CHAIN, HOME, seen, wall, 12, 0.01)
    Ts = np.array([tcp_pose(CHAIN, q) for q in found.q])
    assert len(found.q) == 12
    assert (markers_in_view(MACHINE, Ts, T_base_ooi, MACHINE.T_tcp_cam_left[:3, :3], 10.0) >= 1).all()
    assert (clearances(Ts, MACHINE.T_tcp_tool, wall) >= 0.05).all()
    left = {(name, joint): ratio for name, joint, ratio in found.parameter_sigma_ratios}
    assert left["gravity_sag", 2] < 0.2
    assert left["hand_eye_rotation", None] < 0.3
    assert left["encoder_bias", 3] < 0.4
    assert left["encoder_bias", 1] > 0.9  # a slew zero and an object turned about the slew axis look alike
    near = choose_postures(MACHINE, CHAIN, HOME, seen, wall, 4, 0.01)
    assert dict(((n, j), r) for n, j, r in near.parameter_sigma_ratios)["gravity_sag", 2] > left["gravity_sag", 2]


def test_without_room_for_a_look_there_is_no_posture():
    seen, T_base_ooi = in_front(CHAIN, HOME)
    behind = Wall(T_base_ooi[:3, 3] + 3.0 * T_base_ooi[:3, 2], T_base_ooi[:3, 2], 0.05)
    assert len(choose_postures(MACHINE, CHAIN, HOME, seen, behind, 12, 0.01).q) == 0


def test_an_arm_of_other_kinematics_is_looked_from_as_well_or_the_plan_says_why_not():
    chain = chain_of(FOUR)
    seen, _ = in_front(chain, HOME[:4])
    found = choose_postures(FOUR, chain, HOME[:4], seen, None, 12, 0.01)
    assert len(found.q) == min(12, found.in_view) > 3
    assert {name for name, _, _ in found.parameter_sigma_ratios} >= {"encoder_bias", "gravity_sag", "hand_eye_rotation"}
