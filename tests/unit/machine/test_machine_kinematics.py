"""Forward kinematics and Jacobian against Pinocchio, finite differences and Table 1 by hand."""

import dataclasses

import numpy as np
import pinocchio
import pytest
from machine_cases import CHAIN, MACHINE, QS

from machine import kinematics
from machine.chain import Chain, chain_of
from machine.errors import MachineError
from machine.kinematics import link_poses, sigma_min, tcp_jacobian, tcp_pose, tcp_poses
from machine.urdf import dh_fixed_part


def table_model():
    """Table 1 as a Pinocchio model, built from the DH rows without our URDF or our kernels."""
    model, parent, placement = pinocchio.Model(), 0, pinocchio.SE3.Identity()
    for joint in MACHINE.joints:
        turned = placement * pinocchio.SE3(pinocchio.utils.rotate("z", joint.theta_offset_rad), np.zeros(3))
        parent = model.addJoint(parent, pinocchio.JointModelRZ(), turned, joint.name)
        shift = pinocchio.SE3(np.eye(3), np.array([joint.a_m, 0.0, joint.d_m]))
        placement = shift * pinocchio.SE3(pinocchio.utils.rotate("x", joint.alpha_rad), np.zeros(3))
    tcp = placement * pinocchio.SE3(MACHINE.T_flange_tcp)
    frame = model.addFrame(pinocchio.Frame("tcp", parent, tcp, pinocchio.FrameType.OP_FRAME))
    return model, frame


def test_pose_and_jacobian_equal_pinocchio_over_1000_joint_vectors():
    model, frame = table_model()
    data = model.createData()
    for q in QS:
        J = pinocchio.computeFrameJacobian(model, data, q, frame, pinocchio.LOCAL_WORLD_ALIGNED)
        pinocchio.framesForwardKinematics(model, data, q)
        assert np.abs(tcp_pose(CHAIN, q) - data.oMf[frame].homogeneous).max() < 1e-9  # m, and rotation entries
        assert np.abs(tcp_jacobian(CHAIN, q) - J).max() < 1e-9  # m/rad


def test_jacobian_equals_finite_differences():
    h = 1e-6
    for q in QS[:100]:
        J, R = tcp_jacobian(CHAIN, q), tcp_pose(CHAIN, q)[:3, :3]
        for j in range(CHAIN.n):
            step = h * np.eye(CHAIN.n)[j]
            plus, minus = tcp_pose(CHAIN, q + step), tcp_pose(CHAIN, q - step)
            spin = (plus[:3, :3] - minus[:3, :3]) / (2 * h) @ R.T
            angular = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            assert np.abs(J[:3, j] - (plus[:3, 3] - minus[:3, 3]) / (2 * h)).max() < 1e-7  # m/rad
            assert np.abs(J[3:, j] - angular).max() < 1e-7


def test_batch_equals_one_by_one_and_links_end_at_the_flange():
    Ts = tcp_poses(CHAIN, QS[:50])
    for q, T in zip(QS[:50], Ts, strict=True):
        poses = link_poses(CHAIN, q)
        assert np.array_equal(poses[0], np.eye(4))
        assert np.abs(T - tcp_pose(CHAIN, q)).max() < 1e-15
        assert np.abs(poses[-1] @ CHAIN.T_flange_tcp - T).max() < 1e-14
    assert tcp_poses(CHAIN, np.empty((0, 6))).shape == (0, 4, 4)


def test_neighbouring_links_differ_by_one_row_of_table_1():
    poses = link_poses(CHAIN, QS[0])
    for i, joint in enumerate(MACHINE.joints):
        c, s = np.cos(QS[0][i] + joint.theta_offset_rad), np.sin(QS[0][i] + joint.theta_offset_rad)
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        assert np.abs(poses[i] @ turn @ dh_fixed_part(joint) - poses[i + 1]).max() < 1e-14


@pytest.mark.parametrize("kernel", ["_tcp_pose", "_tcp_jacobian"])
def test_kernels_run_as_plain_python_with_the_same_result(kernel):
    compiled = getattr(kinematics, kernel)
    arguments = (CHAIN.dh_a_m, CHAIN.dh_d_m, CHAIN.dh_alpha_rad, QS[3] + CHAIN.theta_offset, CHAIN.T_flange_tcp)
    assert np.abs(compiled.py_func(*arguments) - compiled(*arguments)).max() < 1e-14


def test_sigma_min_at_the_wrist_singularity_and_30_degrees_away():
    bent = np.deg2rad([0.0, 40.0, -80.0, 0.0, -30.0, 0.0])
    straight = bent * np.array([1, 1, 1, 1, 0, 1])
    assert sigma_min(tcp_jacobian(CHAIN, straight)) < 1e-12
    assert 0.2 < sigma_min(tcp_jacobian(CHAIN, bent)) < 0.5


def test_wrong_shapes_and_values_are_refused():
    for call in (tcp_pose, tcp_jacobian, link_poses):
        with pytest.raises(MachineError, match=r"shape \(5,\).*6 joints"):
            call(CHAIN, np.zeros(5))
        for bad in (np.nan, np.inf):
            with pytest.raises(MachineError, match="not finite"):
                call(CHAIN, np.array([0.0, 0.0, 0.0, bad, 0.0, 0.0]))
    with pytest.raises(MachineError, match=r"\(m, 6\)"):
        tcp_poses(CHAIN, np.zeros(6))
    with pytest.raises(MachineError, match="not finite"):
        tcp_poses(CHAIN, np.full((2, 6), np.nan))


def test_chain_copies_its_arrays_and_refuses_wrong_ones():
    a = CHAIN.dh_a_m.copy()
    chain = dataclasses.replace(CHAIN, dh_a_m=a)
    a[0] = 99.0
    assert chain.dh_a_m[0] == CHAIN.dh_a_m[0]
    with pytest.raises(ValueError, match="read-only"):
        chain.dh_d_m[0] = 1.0
    with pytest.raises(MachineError, match=r"dh_d_m has shape \(5,\)"):
        dataclasses.replace(CHAIN, dh_d_m=np.zeros(5))
    with pytest.raises(MachineError, match="alpha"):
        dataclasses.replace(CHAIN, dh_alpha_rad=np.full(6, np.nan))


def test_chain_of_takes_every_column_from_its_field():
    joints = tuple(
        dataclasses.replace(
            j, a_m=k, d_m=k + 10, alpha_rad=k + 20, theta_offset_rad=k + 30, q_min_rad=k, q_max_rad=k + 1
        )
        for k, j in enumerate(MACHINE.joints)
    )
    chain = chain_of(dataclasses.replace(MACHINE, joints=joints))
    k = np.arange(6.0)
    for column, wanted in (
        (chain.dh_a_m, k),
        (chain.dh_d_m, k + 10),
        (chain.dh_alpha_rad, k + 20),
        (chain.theta_offset, k + 30),
    ):
        assert np.array_equal(column, wanted)
    assert isinstance(chain, Chain)
    assert chain.joint_label(1) == "joint 2 (lift)"
