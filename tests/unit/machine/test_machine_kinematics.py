"""Kinematics against Pinocchio and finite differences; the closed-form inverse against the forward."""

import dataclasses
import io
from importlib.resources import files

import numpy as np
import pinocchio
import pytest
import yourdfpy

from machine.chain import chain_of
from machine.description import parse_machine_toml
from machine.errors import MachineError
from machine.inverse import InverseStatus, inverse_all, inverse_nearest
from machine.kinematics import link_poses, sigma_min, tcp_jacobian, tcp_pose, tcp_poses
from machine.poses import pose
from machine.urdf import urdf_text

N = 1000


@pytest.fixture(scope="module")
def machine():
    return parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def chain(machine):
    return chain_of(machine)


@pytest.fixture(scope="module")
def qs(chain):
    return np.random.default_rng(7).uniform(chain.q_min, chain.q_max, (N, chain.n))


def test_pose_and_jacobian_equal_pinocchio_over_1000_joint_vectors(machine, chain, qs):
    model = pinocchio.buildModelFromXML(urdf_text(machine))
    data = model.createData()
    frame = model.getFrameId("tcp")
    for q in qs:
        J = pinocchio.computeFrameJacobian(model, data, q, frame, pinocchio.LOCAL_WORLD_ALIGNED)
        pinocchio.framesForwardKinematics(model, data, q)
        assert np.abs(tcp_pose(chain, q) - data.oMf[frame].homogeneous).max() < 1e-9
        assert np.abs(tcp_jacobian(chain, q) - J).max() < 1e-9


def test_urdf_read_by_another_parser_gives_our_frames(machine, chain, qs):
    urdf = yourdfpy.URDF.load(io.StringIO(urdf_text(machine)))
    for q in qs[:50]:
        urdf.update_cfg(q)
        T_base_tcp = tcp_pose(chain, q)
        assert np.abs(urdf.get_transform("tcp", "base") - T_base_tcp).max() < 1e-9
        assert np.abs(urdf.get_transform("tool", "base") - T_base_tcp @ machine.T_tcp_tool).max() < 1e-9
        assert np.abs(urdf.get_transform("cam_left", "base") - T_base_tcp @ machine.T_tcp_cam_left).max() < 1e-9


def test_jacobian_equals_finite_differences(chain, qs):
    h = 1e-6
    for q in qs[:100]:
        J = tcp_jacobian(chain, q)
        for j in range(chain.n):
            step = np.zeros(chain.n)
            step[j] = h
            plus, minus = tcp_pose(chain, q + step), tcp_pose(chain, q - step)
            linear = (plus[:3, 3] - minus[:3, 3]) / (2 * h)
            spin = (plus[:3, :3] - minus[:3, :3]) / (2 * h) @ tcp_pose(chain, q)[:3, :3].T
            angular = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            assert np.abs(J[:3, j] - linear).max() < 1e-7
            assert np.abs(J[3:, j] - angular).max() < 1e-7


@pytest.mark.parametrize("d3_m", [0.0, 0.05])
def test_inverse_recovers_every_joint_vector(chain, qs, d3_m):
    d = chain.d.copy()
    d[2] = d3_m
    chain = dataclasses.replace(chain, d=d)
    recovered = 0
    for q in qs:
        found = inverse_nearest(chain, tcp_pose(chain, q), q)
        recovered += found.q is not None and np.abs(found.q - q).max() < 1e-7
    assert recovered == N


def test_every_branch_reproduces_its_pose(chain, qs):
    counts = []
    for q in qs[:300]:
        T = tcp_pose(chain, q)
        branches = inverse_all(chain, T, q)
        counts.append(len(branches))
        for branch in branches:
            assert np.abs(tcp_pose(chain, branch.q) - T).max() < 1e-9
    assert max(counts) == 8


def test_singular_wrist_keeps_theta4_and_says_so(chain):
    q = np.deg2rad([10.0, 30.0, -60.0, 25.0, 0.0, -40.0])
    found = inverse_nearest(chain, tcp_pose(chain, q), q)
    assert found.status is InverseStatus.SINGULAR
    assert found.q is not None
    assert np.abs(found.q - q).max() < 1e-7
    assert sigma_min(tcp_jacobian(chain, q)) < 1e-6


def test_out_of_reach_and_out_of_limits_are_named(chain):
    far = inverse_nearest(chain, pose(np.eye(3), np.array([9.0, 0.0, 1.0])), np.zeros(6))
    assert far.status is InverseStatus.OUT_OF_REACH
    assert "reaches at most" in far.reason
    q = np.deg2rad([0.0, 90.0, -60.0, 0.0, -30.0, 0.0])  # lift beyond its 80 deg
    limited = inverse_nearest(chain, tcp_pose(chain, q), q)
    assert limited.status in (InverseStatus.JOINT_LIMIT, InverseStatus.OK)
    tight = dataclasses.replace(chain, q_min=q - 0.3, q_max=np.minimum(q + 0.3, chain.q_max))
    limited = inverse_nearest(tight, tcp_pose(chain, q), q)
    assert limited.status is InverseStatus.JOINT_LIMIT
    assert "joint 2" in limited.reason
    assert "80.0 deg" in limited.reason


def test_table_1_axis_of_joint_6_is_minus_z_tcp(chain, qs):
    for q in qs[:20]:
        assert np.dot(link_poses(chain, q)[5][:3, 2], tcp_pose(chain, q)[:3, 2]) == pytest.approx(-1.0, abs=1e-12)


def test_at_zero_the_tcp_is_at_reach_and_height_and_z_points_back(chain):
    T = tcp_pose(chain, np.zeros(6))
    assert T[:3, 3] == pytest.approx([4.76, 0.0, 1.89], abs=1e-12)
    assert T[:3, 2] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-12)


def test_wrong_shapes_and_values_are_refused(chain):
    with pytest.raises(MachineError, match=r"6 joints"):
        tcp_pose(chain, np.zeros(5))
    with pytest.raises(MachineError, match="not finite"):
        tcp_pose(chain, np.full(6, np.nan))
    assert tcp_poses(chain, np.zeros((3, 6))).shape == (3, 4, 4)
