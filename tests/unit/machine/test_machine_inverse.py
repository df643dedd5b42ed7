"""The closed-form inverse against the forward kinematics, at and near its three singularities, and its refusals."""

import dataclasses

import numpy as np
import pytest
from machine_cases import CHAIN, QS

from machine import inverse
from machine.errors import MachineError
from machine.inverse import InverseStatus, inverse_all, inverse_nearest
from machine.kinematics import link_poses, sigma_min, tcp_jacobian, tcp_pose
from machine.poses import pose
from machine.rotations import rotation_from_rotvec


def chain_with(**columns):
    """The nominal chain with single entries changed: dh_d_m={2: 0.05}."""
    changed = {}
    for name, entries in columns.items():
        values = getattr(CHAIN, name).copy()
        for index, value in entries.items():
            values[index] = value
        changed[name] = values
    return dataclasses.replace(CHAIN, **changed)


TILTED_LINK_7 = pose(rotation_from_rotvec(np.array([1.2, -0.4, 0.3])), np.array([0.02, -0.05, 0.2]))
CHAINS = {
    "nominal": CHAIN,
    "d3": chain_with(dh_d_m={2: 0.05}),
    "d3 negative, a1 and a3 0": chain_with(dh_d_m={2: -0.08}, dh_a_m={0: 0.0, 2: 0.0}),
    "other zeros": chain_with(theta_offset={0: 0.3, 1: -0.2, 2: 1.0, 3: 0.5, 4: 0.1, 5: -2.0}),
    "other link 7": dataclasses.replace(CHAIN, T_flange_tcp=TILTED_LINK_7),
}


@pytest.mark.parametrize("name", CHAINS)
def test_inverse_recovers_1000_of_1000_joint_vectors(name):
    chain = CHAINS[name]
    found = [inverse_nearest(chain, tcp_pose(chain, q), q) for q in QS]
    assert sum(f.q_rad is not None and np.abs(f.q_rad - q).max() < 1e-7 for f, q in zip(found, QS, strict=True)) == len(
        QS
    )


@pytest.mark.parametrize("name", CHAINS)
def test_every_branch_reproduces_its_pose(name):
    chain, counts = CHAINS[name], []
    for q in QS:
        T = tcp_pose(chain, q)
        branches = inverse_all(chain, T, q)
        counts.append(len(branches))
        for branch in branches:
            assert np.abs(tcp_pose(chain, branch.q_rad) - T).max() < 1e-9  # m, and rotation entries
            inside = bool(np.all(branch.q_rad >= chain.q_min - 1e-9) and np.all(branch.q_rad <= chain.q_max + 1e-9))
            assert branch.inside_limits == inside
    assert max(counts) == 8


def test_branches_are_eight_different_postures():
    branches = inverse_all(CHAIN, tcp_pose(CHAIN, np.deg2rad([10.0, 30.0, -60.0, 20.0, -40.0, 15.0])))
    turned = np.array([np.concatenate([np.cos(b.q_rad), np.sin(b.q_rad)]) for b in branches])
    apart = np.abs(turned[:, None] - turned[None]).max(axis=2) + np.eye(8)
    assert apart.min() > 0.01


@pytest.mark.parametrize("theta5_rad", [0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-5, -1e-7, -1e-9])
def test_it_is_sound_at_and_near_theta5_zero(theta5_rad):
    for q in QS[:100]:
        q = q.copy()
        q[4] = theta5_rad
        T = tcp_pose(CHAIN, q)
        found = inverse_nearest(CHAIN, T, q)
        assert found.status is InverseStatus.SINGULAR
        assert "joint 5 (wrist2) is at" in found.reason
        assert found.q_rad is not None
        assert np.abs(tcp_pose(CHAIN, found.q_rad) - T).max() < 2e-9  # m
        assert found.sigma_min == pytest.approx(sigma_min(tcp_jacobian(CHAIN, found.q_rad)), abs=1e-12)


def test_exactly_at_theta5_zero_theta4_stays_where_it_is():
    q = np.deg2rad([10.0, 30.0, -60.0, 25.0, 0.0, -40.0])
    found = inverse_nearest(CHAIN, tcp_pose(CHAIN, q), q)
    assert found.q_rad is not None
    assert np.abs(found.q_rad - q).max() < 1e-7  # rad
    other = q + np.deg2rad([0.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    found = inverse_nearest(CHAIN, tcp_pose(CHAIN, q), other)
    assert found.q_rad is not None
    assert found.q_rad[3] + found.q_rad[5] == pytest.approx(q[3] + q[5], abs=1e-7)
    assert found.q_rad[3] == pytest.approx(other[3], abs=1e-7)


def test_over_the_slew_axis_theta1_stays_where_it_is():
    chain = chain_with(q_max={2: np.deg2rad(30.0)}, q_min={2: np.deg2rad(-179.0)})
    q = np.deg2rad([50.0, 80.0, 0.0, 20.0, -40.0, 15.0])

    def radius(tilt_rad):
        q[2] = tilt_rad
        return link_poses(chain, q)[4][:2, 3] @ [np.cos(q[0]), np.sin(q[0])]

    low, high = np.deg2rad(0.0), np.deg2rad(30.0)
    for _ in range(80):  # bisection: the tilt that puts the wrist centre on the slew axis
        middle = (low + high) / 2.0
        low, high = (middle, high) if radius(low) * radius(middle) > 0.0 else (low, middle)
    assert abs(radius((low + high) / 2.0)) < 1e-12
    T = tcp_pose(chain, q)
    found = inverse_nearest(chain, T, q)
    assert found.q_rad is not None
    assert np.abs(found.q_rad - q).max() < 1e-6
    assert found.status is InverseStatus.SINGULAR
    assert "slew axis" in found.reason


def test_stretched_booms_are_named():
    forearm_bend = np.arctan2(CHAIN.dh_d_m[3], CHAIN.dh_a_m[2]) - CHAIN.theta_offset[2]  # -3.8 deg
    chain = chain_with(q_max={2: 0.0})
    q = np.array([0.2, 0.5, forearm_bend, 0.3, -0.6, 0.1])
    found = inverse_nearest(chain, tcp_pose(chain, q), q)
    assert found.status is InverseStatus.SINGULAR
    assert "booms are in line" in found.reason
    assert found.q_rad is not None
    assert np.abs(tcp_pose(chain, found.q_rad) - tcp_pose(chain, q)).max() < 1e-7


def test_angles_take_the_turn_nearest_to_where_the_machine_stands():
    chain = chain_with(q_min={3: -7.0, 5: -7.0}, q_max={3: 7.0, 5: 7.0})
    q = np.array([0.3, 0.5, -1.2, 3.5, -0.7, -4.0])
    found = inverse_nearest(chain, tcp_pose(chain, q), q)
    assert found.q_rad is not None
    assert np.abs(found.q_rad - q).max() < 1e-7
    lower = q - np.array([0.0, 0.0, 0.0, 2 * np.pi, 0.0, 0.0])
    found = inverse_nearest(chain, tcp_pose(chain, q), lower)
    assert found.q_rad is not None
    assert found.q_rad[3] == pytest.approx(lower[3], abs=1e-7)
    far = q + np.array([0.0, 0.0, 0.0, 40.0, 0.0, 0.0])  # no turn there lies inside: the nearest that does
    found = inverse_nearest(chain, tcp_pose(chain, q), far)
    assert found.q_rad is not None
    assert -7.0 <= found.q_rad[3] <= 7.0


def test_out_of_reach_names_distance_limit_and_remedy():
    far = inverse_nearest(CHAIN, pose(np.eye(3), np.array([9.0, 0.0, 1.0])), np.zeros(6))
    assert far.status is InverseStatus.OUT_OF_REACH
    assert far.q_rad is None
    assert "joint 2 (lift)" in far.reason
    assert "reaches at most 4.05 m" in far.reason
    assert "nearer" in far.reason
    centred = chain_with(dh_a_m={0: 0.0})
    close = inverse_nearest(centred, pose(tcp_pose(CHAIN, np.zeros(6))[:3, :3], [0.60, 0.0, 1.75]), np.zeros(6))
    assert close.status is InverseStatus.OUT_OF_REACH
    assert "further away" in close.reason
    shifted = chain_with(dh_d_m={2: 0.05})
    inside = pose(tcp_pose(CHAIN, np.zeros(6))[:3, :3], [0.55, 0.0, 3.5])  # the wrist centre on the slew axis
    beside = inverse_nearest(shifted, inside, np.zeros(6))
    assert beside.status is InverseStatus.OUT_OF_REACH
    assert "0.050 m off it" in beside.reason


@pytest.mark.parametrize("index", range(6))
def test_each_joint_limit_is_found_and_named(index):
    """Inside its limit by 0.1 deg the posture is found; beyond it by 0.1 deg it is refused, if no branch is left."""
    q = np.deg2rad([10.0, 30.0, -60.0, 20.0, -40.0, 15.0])
    T = tcp_pose(CHAIN, q)
    tight = dataclasses.replace(CHAIN, q_min=q - 0.3, q_max=q + 0.3)
    for share, status in ((-1.0, InverseStatus.OK), (1.0, InverseStatus.JOINT_LIMIT)):
        q_max = tight.q_max.copy()
        q_max[index] = q[index] - share * np.deg2rad(0.1)
        found = inverse_nearest(dataclasses.replace(tight, q_max=q_max), T, q)
        assert found.status is status
        if status is InverseStatus.JOINT_LIMIT:
            assert found.q_rad is None
            assert f"joint {index + 1}" in found.reason
            assert f"{np.rad2deg(q[index]):.1f} deg" in found.reason
            assert f".. {np.rad2deg(q_max[index]):.1f} deg" in found.reason


def test_broken_contracts_raise():
    T = tcp_pose(CHAIN, QS[0])
    with pytest.raises(MachineError, match="twists of Table 1"):
        inverse_all(chain_with(dh_alpha_rad={1: 0.1}), T)
    with pytest.raises(MachineError, match="spherical"):
        inverse_all(chain_with(dh_a_m={4: 0.1}), T)
    with pytest.raises(MachineError, match="two booms"):
        inverse_all(chain_with(dh_a_m={1: 0.0}), T)
    with pytest.raises(MachineError, match="orthonormal"):
        inverse_all(CHAIN, np.diag([1.0, 1.0, 1.01, 1.0]))
    with pytest.raises(MachineError, match="mirrored"):
        inverse_all(CHAIN, np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(MachineError, match="not finite"):
        inverse_all(CHAIN, np.full((4, 4), np.nan))
    with pytest.raises(MachineError, match="six finite"):
        inverse_nearest(CHAIN, T, np.zeros(5))


def test_kernels_run_as_plain_python_with_the_same_result(monkeypatch):
    arguments = (CHAIN.dh_a_m, CHAIN.dh_d_m, tcp_pose(CHAIN, QS[5]), QS[5] + CHAIN.theta_offset)
    count, angles = inverse.solve_angles(*arguments)
    for name in ("_arm_angles", "_wrist_rotation", "_wrist_angles"):
        monkeypatch.setattr(inverse, name, getattr(inverse, name).py_func)
    count_plain, angles_plain = inverse.solve_angles.py_func(*arguments)
    assert count == count_plain
    assert np.abs(angles[:count] - angles_plain[:count]).max(initial=0.0) < 1e-12
