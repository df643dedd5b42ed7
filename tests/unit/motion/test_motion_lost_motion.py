"""Stall in the dead band: references that carry across it, what rests teach, and coming again."""

import re

import numpy as np
import pytest
from motion_scenes import Q_USUAL, chain, machine, shifted

from machine.kinematics import tcp_pose
from server.motion.approach import plan_approach, play_of
from server.motion.contracts import PlanStatus, Wall, sample_trajectory
from server.motion.lost_motion import (
    first_stall,
    last_direction,
    onto_reference,
    plan_trim,
    updated_stall,
    worth_trimming,
)
from server.motion.settings import PAPER_PLAN_SETTINGS as PLAIN

STALL = np.deg2rad([0.4, 0.1, 0.1, 0.17, 0.14, 0.16])
PLAY = play_of(6)


def rest_after(q_start, trajectory, stall):
    """Where joints with a dead band rest: each follows its reference at its stall, like a dragged weight."""
    q = q_start.copy()
    for q_ref in sample_trajectory(trajectory, 0.01)[1].q:
        q = np.clip(q, q_ref - stall, q_ref + stall)
    return q


def planned(seed):
    rng = np.random.default_rng(seed)
    plan = plan_approach(machine(), Q_USUAL, shifted(Q_USUAL, rng.uniform(-0.15, 0.15, 3).tolist()))
    assert plan.trajectory is not None, plan.reason
    return plan, Q_USUAL + STALL * rng.choice([-1.0, 1.0], 6)


@pytest.mark.parametrize("seed", range(6))
def test_with_the_right_stall_a_path_ends_where_it_was_planned(seed):
    plan, q_ref = planned(seed)
    reference = onto_reference(plan.trajectory, q_ref, STALL)
    assert (reference.q[0] == q_ref).all()
    np.testing.assert_allclose(reference.q[-1], plan.q_end + STALL, atol=1e-12)
    assert np.abs(reference.qd[[0, -1]]).max() == pytest.approx(0.0, abs=1e-12)
    assert np.abs(reference.qdd[[0, -1]]).max() == pytest.approx(0.0, abs=1e-9)
    q = rest_after(Q_USUAL, reference, STALL)
    assert np.rad2deg(np.abs(q - plan.q_end)).max() < 0.005


@pytest.mark.parametrize("seed", range(3))
def test_the_moved_reference_is_as_smooth_as_its_derivatives_say(seed):
    plan, q_ref = planned(seed)
    reference = onto_reference(plan.trajectory, q_ref, STALL)
    t, motion = sample_trajectory(reference, 0.002)
    steps = np.diff(motion.q, axis=0) / np.diff(t)[:, None]
    middle = (motion.qd[1:] + motion.qd[:-1]) / 2.0
    assert np.abs(steps - middle).max() < 1e-3  # rad/s


def test_a_wrong_first_guess_is_learnt_and_undone_by_coming_again():
    plan, _ = planned(1)
    guess = first_stall(machine())
    reference = onto_reference(plan.trajectory, Q_USUAL, guess)
    q, q_ref = rest_after(Q_USUAL, reference, STALL), reference.q[-1]
    assert worth_trimming(machine(), q, plan.q_end - q).any()
    stall, stuck = updated_stall(guess, q_ref, q, last_direction(reference), PLAY)
    assert not stuck.any()
    np.testing.assert_allclose(stall, STALL, atol=1e-6)
    again = plan_trim(machine(), q_ref, q, plan.q_end, stall, PLAY, PLAIN)
    assert again.trajectory is not None
    q = rest_after(q, again.trajectory, STALL)
    assert not worth_trimming(machine(), q, plan.q_end - q).any()


def test_a_joint_held_by_stiction_teaches_nothing_and_is_told():
    forward = np.ones(6)
    q_ref = Q_USUAL + STALL
    held = Q_USUAL - np.array([0.0, 0.9 * PLAY[1], 0.0, 0.0, 0.0, 0.0])
    stall, stuck = updated_stall(STALL, q_ref, held, forward, PLAY)
    assert stuck.tolist() == [False, True, False, False, False, False]
    np.testing.assert_allclose(stall, STALL, atol=1e-12)


def test_joints_that_did_not_move_teach_nothing():
    stall, stuck = updated_stall(STALL, Q_USUAL + 0.02, Q_USUAL, np.zeros(6), PLAY)
    assert (stall == STALL).all()
    assert not stuck.any()


def test_only_lacking_joints_are_moved_by_a_trim():
    q_goal = Q_USUAL + np.array([0.0, 0.003, 0.0, 0.0, 0.0, 0.0])
    plan = plan_trim(machine(), Q_USUAL + STALL, Q_USUAL, q_goal, STALL, PLAY, PLAIN)
    assert plan.trajectory is not None
    moved = np.ptp(plan.trajectory.q, axis=0)
    assert moved[1] > PLAY[1]
    assert moved[[0, 2, 3, 4, 5]].max() < 1e-12


def beneath(clearance_m: float, side: float = 1.0) -> Wall:
    """A wall 160 mm under the tool, or over it (side -1): a lift that comes from below goes down first."""
    up = np.array([0.0, 0.0, side])
    return Wall(tcp_pose(chain(), Q_USUAL)[:3, 3] - 0.16 * up, up, clearance_m)


def trimmed(wall: Wall | None, play_deg: float, stall_rad=STALL):
    """The trim of a lift that lacks 3 mrad."""
    q_goal = Q_USUAL + np.array([0.0, 3e-3, 0.0, 0.0, 0.0, 0.0])
    play = np.deg2rad(np.full(6, play_deg))
    return plan_trim(machine(), Q_USUAL + stall_rad, Q_USUAL, q_goal, stall_rad, play, PLAIN, wall)


def test_a_trim_keeps_off_the_wall():
    assert trimmed(None, 2.5).status is PlanStatus.OK
    assert trimmed(beneath(0.14, side=-1.0), 2.5).status is PlanStatus.OK
    refused = trimmed(beneath(0.14), 2.5)
    assert (refused.status, refused.trajectory) == (PlanStatus.WALL, None)
    assert re.search(r"comes to \d+ mm from the wall, limit 140 mm; choose a larger stand-off", refused.reason)


def test_a_trim_is_judged_where_the_joints_go_and_not_where_their_reference_leads_them():
    plan = trimmed(beneath(0.13), 0.4, stall_rad=np.deg2rad(np.full(6, 3.0)))
    assert plan.status is PlanStatus.OK, plan.reason
    assert 0.13 < plan.clearance_m < 0.16
