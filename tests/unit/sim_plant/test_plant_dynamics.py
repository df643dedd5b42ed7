"""The multibody kernel against Pinocchio, the tree against the DH chain, the sag against statics."""

import numpy as np
import pinocchio as pin
import pytest

from machine.chain import chain_of
from machine.kinematics import tcp_pose
from sim_plc.draw_plant import nominal_kinematics
from sim_plc.plant import sizing
from sim_plc.plant.aba import aba, aba_work
from sim_plc.plant.statics import frames, gravity_torques, static_equilibrium_angles
from sim_plc.plant.tree import FLEX_JOINT_INDICES, MOTOR_JOINT_INDICES, N_TREE_JOINTS, build_tree

GRAVITY = np.array([0.0, 0.0, -9.81])
SPRINGS_NM_RAD = np.array([1.5e6, 5e5, 1.0e6, 5e5, 3e5])  # the default plant


@pytest.fixture(scope="module")
def tree(nominal):
    return build_tree(nominal_kinematics(nominal), sizing.link_inertias(nominal))


@pytest.fixture(scope="module")
def pin_model(tree):
    model = pin.Model()
    model.gravity.linear = GRAVITY
    parent = 0
    for i in range(N_TREE_JOINTS):
        placement = pin.SE3(tree.tree_R[i], tree.tree_p[i])
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"joint_{i}")
        body = pin.Inertia(float(tree.mass_kg[i]), tree.com_m[i], tree.inertia_kg_m2[i])
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.armature = tree.armature_kg_m2
    return model


def test_aba_agrees_with_pinocchio(tree, pin_model):
    data, work, qdd = pin_model.createData(), aba_work(N_TREE_JOINTS), np.zeros(N_TREE_JOINTS)
    rng = np.random.default_rng(1)
    for _ in range(200):
        q, qd, tau = rng.normal(size=11), rng.normal(size=11), 1e3 * rng.normal(size=11)
        aba(
            tree.tree_R, tree.tree_p, tree.mass_kg, tree.com_m, tree.inertia_kg_m2, tree.armature_kg_m2, GRAVITY,
            q, qd, tau, work, qdd,
        )  # fmt: skip
        expected = pin.aba(pin_model, data, q, qd, tau)
        np.testing.assert_allclose(qdd, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())  # rad/s2


def test_gravity_torques_agree_with_pinocchio(tree, pin_model):
    data = pin_model.createData()
    for q in np.random.default_rng(2).normal(size=(20, 11)):
        expected = -pin.computeGeneralizedGravity(pin_model, data, q)
        np.testing.assert_allclose(gravity_torques(tree, GRAVITY, q), expected, atol=1e-8)  # N m


def test_tree_without_bending_is_the_dh_chain(nominal, tree):
    chain = chain_of(nominal)
    for q_motor in np.random.default_rng(3).uniform(-1.0, 1.0, size=(50, 6)):
        q = np.zeros(N_TREE_JOINTS)
        q[MOTOR_JOINT_INDICES] = q_motor
        R, p = frames(tree, q)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R[-1], p[-1]
        np.testing.assert_allclose(T @ tree.T_last_tcp, tcp_pose(chain, q_motor), atol=1e-12)  # m


def _sag_m(tree, q_motor):
    rigid = np.zeros(N_TREE_JOINTS)
    rigid[MOTOR_JOINT_INDICES] = q_motor
    heights = []
    for q in (rigid, static_equilibrium_angles(tree, GRAVITY, q_motor, SPRINGS_NM_RAD)):
        R, p = frames(tree, q)
        heights.append((R[-1] @ tree.T_last_tcp[:3, 3] + p[-1])[2])
    return heights[0] - heights[1]


def test_sag_of_the_default_plant_is_of_the_expected_size(tree):
    stretched = np.deg2rad([0.0, 10.0, -15.0, 0.0, -5.0, 0.0])  # about 4.7 m
    folded = np.deg2rad([0.0, 45.0, -95.0, 0.0, -50.0, 0.0])  # about 3.4 m
    assert 0.025 < _sag_m(tree, stretched) < 0.045  # m
    assert 0.015 < _sag_m(tree, folded) < 0.030  # m


def test_sag_is_where_the_springs_carry_the_weight(tree):
    q = static_equilibrium_angles(tree, GRAVITY, np.deg2rad([20.0, 40.0, -80.0, 5.0, -40.0, 3.0]), SPRINGS_NM_RAD)
    residual = gravity_torques(tree, GRAVITY, q)[FLEX_JOINT_INDICES] - SPRINGS_NM_RAD * q[FLEX_JOINT_INDICES]
    assert np.abs(residual).max() < 1e-6  # N m


def test_full_command_gives_the_nominal_speeds(nominal, tree):
    actuator = sizing.build_actuator_truth(nominal)
    gain = sizing.flow_gains(nominal, tree, GRAVITY, actuator)
    wanted = np.array([joint.velocity_gain_rad_s for joint in nominal.joints])
    speeds = sizing.joint_speeds(tree, GRAVITY, actuator, gain, sizing.SIZING_POSTURE_RAD)
    assert np.abs(speeds / wanted[:, None] - 1.0).max() < 0.10
    np.testing.assert_allclose(speeds.mean(axis=1), wanted, rtol=1e-3)
