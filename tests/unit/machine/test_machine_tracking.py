"""Resolved-rate tracking follows a path, heals errors, stays bounded at the wrist singularity, says why it fails."""

import dataclasses

import numpy as np
import pytest
from machine_cases import CHAIN, QS

from machine.errors import MachineError
from machine.inverse import inverse_nearest
from machine.kinematics import sigma_min, tcp_jacobian, tcp_pose
from machine.poses import pose
from machine.rotations import rotation_from_rotvec, rotvec_from_rotation
from machine.tracking import TrackingGains, TrackStatus, joint_rates, pose_error, track_path, track_step

Q = np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0])


def straight(q, shift, turn=(0.0, 0.0, 0.0), n=200):
    """Poses from where q stands: moved by shift [m], turned by a rotation vector [rad], smooth in time."""
    T, s = tcp_pose(CHAIN, q), np.linspace(0.0, 1.0, n)
    s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    return np.array(
        [pose(rotation_from_rotvec(k * np.array(turn)) @ T[:3, :3], T[:3, 3] + k * np.array(shift)) for k in s]
    )


def test_follows_a_line_with_a_turn_and_agrees_with_the_closed_form():
    Ts = straight(Q, [0.2, 0.1, -0.1], [0.05, -0.1, 0.1])
    tracked = track_path(CHAIN, Q, Ts, 0.01)
    assert tracked.status is TrackStatus.OK
    assert tracked.reason == ""
    assert tracked.position_error_max_m < 2e-4
    assert tracked.rotation_error_max_rad < 2e-4
    assert tracked.sigma_min.shape == (200,)
    assert tracked.sigma_min[-1] == pytest.approx(sigma_min(tcp_jacobian(CHAIN, tracked.qs[-1])), abs=1e-12)
    exact = inverse_nearest(CHAIN, Ts[-1], tracked.qs[-1])
    assert exact.q is not None
    assert np.abs(exact.q - tracked.qs[-1]).max() < 1e-3  # rad


def test_feedback_heals_a_start_error_at_the_rate_of_its_gain():
    Ts = np.repeat(straight(Q, [0.0, 0.0, 0.0], n=1), 101, axis=0)
    start = Q + np.deg2rad(0.005)
    tracked = track_path(CHAIN, start, Ts, 0.01, TrackingGains(k_position=4.0, k_rotation=4.0))
    first, _ = pose_error(tcp_pose(CHAIN, start), Ts[0])
    last, _ = pose_error(tcp_pose(CHAIN, tracked.qs[-1]), Ts[0])
    assert np.linalg.norm(last) / np.linalg.norm(first) == pytest.approx(0.96**100, rel=0.02)


def test_one_step_is_equation_4_and_5_away_from_singularities():
    for q in QS[np.abs(QS[:, 4]) > 0.6][:50]:
        J = tcp_jacobian(CHAIN, q)
        if sigma_min(J) < 0.1:
            continue
        T = tcp_pose(CHAIN, q)
        T_des = pose(rotation_from_rotvec(np.array([0.01, 0.0, 0.02])) @ T[:3, :3], T[:3, 3] + [0.003, 0.0, -0.001])
        v_des = np.array([0.1, 0.0, -0.05, 0.02, 0.0, 0.1])
        feedback = np.array([0.003, 0.0, -0.001, 0.01, 0.0, 0.02])
        wanted = q + np.linalg.solve(J, v_des + 8.0 * feedback) * 0.001
        assert np.abs(track_step(CHAIN, q, T_des, v_des, 0.001, TrackingGains()) - wanted).max() < 1e-9


def test_damping_touches_only_the_lost_direction():
    q = np.deg2rad([0.0, 40.0, -60.0, 20.0, 0.5, -10.0])
    J = tcp_jacobian(CHAIN, q)
    u, s, _ = np.linalg.svd(J)
    assert s[-1] < 0.01
    twist = np.array([0.1, 0.05, -0.05, 0.1, 0.2, 0.1])
    rates, smallest = joint_rates(J, twist, 0.0, TrackingGains())
    lag = u.T @ (J @ rates - twist)
    assert smallest == pytest.approx(s[-1])
    assert np.abs(lag[:5]).max() < 1e-12
    assert abs(lag[5]) > 1e-3
    assert np.linalg.norm(rates) < np.linalg.norm(twist) / (2 * 0.03) + np.linalg.norm(twist) / s[-2]
    slower, _ = joint_rates(J, twist, 0.04, TrackingGains())
    assert np.linalg.norm(slower) < np.linalg.norm(rates)


@pytest.mark.parametrize("beside_deg", [0.0, 0.1, 1.0])
def test_stays_bounded_past_the_wrist_singularity_and_says_so(beside_deg):
    """theta5 from 3 to -3 deg, exactly through 0 or past it sideways, where the exact joints would turn half round."""
    q = np.deg2rad([0.0, 40.0, -60.0, 20.0, 3.0, -10.0])
    T, T_end = tcp_pose(CHAIN, q), tcp_pose(CHAIN, q * np.array([1, 1, 1, 1, -1, 1]))
    turn = rotvec_from_rotation(T_end[:3, :3] @ T[:3, :3].T)
    side = np.deg2rad(beside_deg) * np.cross(turn, T[:3, 2]) / np.linalg.norm(turn)
    Ts = [
        pose(rotation_from_rotvec(np.sin(np.pi * s) * side) @ rotation_from_rotvec(s * turn) @ T[:3, :3], T[:3, 3])
        for s in np.linspace(0.0, 1.0, 400)
    ]
    tracked = track_path(CHAIN, q, np.array(Ts), 0.01)
    speeds = np.abs(np.diff(tracked.qs, axis=0)).max() / 0.01
    assert speeds < np.deg2rad(150.0)  # rad/s
    assert tracked.sigma_min.min() < 0.05
    assert tracked.rotation_error_max_rad < np.deg2rad(3.0)
    assert np.isfinite(tracked.qs).all()
    lost = tracked.rotation_error_max_rad > np.deg2rad(0.1) or tracked.position_error_max_m > 1e-3
    assert tracked.status is (TrackStatus.SINGULAR if lost else TrackStatus.OK)
    assert ("smallest singular value" in tracked.reason) == lost
    assert lost or beside_deg < 1.0


def test_a_joint_limit_is_named_with_its_place():
    tight = dataclasses.replace(CHAIN, q_max=np.where(np.arange(6) == 1, Q + np.deg2rad(2.0), CHAIN.q_max))
    tracked = track_path(tight, Q, straight(Q, [0.0, 0.0, 0.6]), 0.01)
    assert tracked.status is TrackStatus.JOINT_LIMIT
    assert "joint 2 (lift) would be at 42." in tracked.reason
    assert "-25.0 .. 42.0 deg" in tracked.reason
    assert "% of the path" in tracked.reason
    assert len(tracked.qs) == 200


def test_a_path_too_coarse_is_off_path():
    tracked = track_path(
        CHAIN, Q, straight(Q, [0.5, 0.3, -0.3], n=6), 0.01, TrackingGains(k_position=0.0, k_rotation=0.0)
    )
    assert tracked.status is TrackStatus.OFF_PATH
    assert "mm" in tracked.reason
    assert "tolerance 1 mm" in tracked.reason


def test_broken_contracts_raise():
    Ts = straight(Q, [0.1, 0.0, 0.0])
    with pytest.raises(MachineError, match="off the path"):
        track_path(CHAIN, Q + 0.1, Ts, 0.01)
    with pytest.raises(MachineError, match="above 0 s"):
        track_path(CHAIN, Q, Ts, 0.0)
    with pytest.raises(MachineError, match=r"\(m, 4, 4\)"):
        track_path(CHAIN, Q, Ts[0], 0.01)
    with pytest.raises(MachineError, match=r"twist \(6,\)"):
        track_step(CHAIN, Q, Ts[0], np.zeros(3), 0.01, TrackingGains())
