"""Machines that differ from their file, their paths and looks: truth for the joint estimate's tests.

The kinematics here are written out by themselves, so that the estimate is not judged by its own model.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from machine.chain import chain_of
from machine.description import Machine, parse_machine_toml
from machine.inverse import inverse_nearest
from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from server.calibration.contracts import CameraTrack
from server.calibration.joint_observations import JointTrack, LookAt, OdometryRun
from server.calibration.kinematic_errors import ErrorPrior
from server.calibration.play import play_sides
from server.motion.calibration_paths import folded_corners

ROOT = Path(__file__).parents[3]
GOAL = pose(np.eye(3), np.array([0.0, 0.0, 0.1]))
NO_PLAY = np.zeros(6)
NOMINAL_PLAY = np.array(ErrorPrior().mean_play_rad + (0.0,) * 6)[:6]
Q_START = np.deg2rad([12.0, 25.0, -80.0, 5.0, -40.0, -4.0])


@lru_cache
def machine() -> Machine:
    return parse_machine_toml((ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8"))


@dataclass
class TrueMachine:
    """DH numbers as they really are, sag of lift and tilt [rad/(N m)], camera and tool marker as they really sit."""

    a: np.ndarray
    d: np.ndarray
    zero: np.ndarray
    compliance: np.ndarray
    T_tcp_cam: np.ndarray
    T_tcp_tool: np.ndarray

    def links(self, q):
        Ts = [np.eye(4)]
        for i, joint in enumerate(machine().joints):
            theta = q[i] + joint.theta_offset_rad
            c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
            rows = [[c, -s * ca, s * sa, self.a[i] * c], [s, c * ca, -c * sa, self.a[i] * s], [0.0, sa, ca, self.d[i]]]
            Ts.append(Ts[-1] @ np.array([*rows, [0.0, 0.0, 0.0, 1.0]]))
        return Ts

    def tcp(self, q):
        q = q + self.zero
        links = self.links(q)
        bent = q.copy()
        for j in (1, 2):
            moment = 0.0
            for i in range(j, 6):
                joint = machine().joints[i]
                com = links[i + 1][:3, 3] + links[i + 1][:3, :3] @ np.array(joint.com_m)
                force = joint.mass_kg * np.array([0.0, 0.0, -9.81])
                moment += links[j][:3, 2] @ np.cross(com - links[j][:3, 3], force)
            bent[j] += self.compliance[j] * moment
        return self.links(bent)[-1] @ machine().T_flange_tcp


def nominal_machine() -> TrueMachine:
    joints = machine().joints
    a, d = np.array([j.a_m for j in joints]), np.array([j.d_m for j in joints])
    return TrueMachine(a, d, np.zeros(6), np.zeros(6), machine().T_tcp_cam_left.copy(), machine().T_tcp_tool.copy())


def drawn_machine(rng) -> TrueMachine:
    """3.5 mm of length, 0.25 deg of zero, springs of a crane, a camera up to 5 deg off, a tool marker 1 deg off."""
    it = nominal_machine()
    for lengths, used in ((it.a, [0, 1, 2]), (it.d, [0, 2, 3, 5])):
        lengths[used] += rng.normal(0.0, 3.5e-3, len(used))
    it.zero[:] = rng.normal(0.0, np.deg2rad(0.25), 6)
    it.compliance[1], it.compliance[2] = 1e-6 / rng.uniform(0.6, 1.5), 1e-6 / rng.uniform(0.4, 1.0)
    axis = rng.normal(size=3)
    turn = np.deg2rad(rng.uniform(0.0, 5.0)) * axis / np.linalg.norm(axis)
    it.T_tcp_cam[:3, :3] = it.T_tcp_cam[:3, :3] @ rotation_from_rotvec(turn)
    it.T_tcp_cam[:3, 3] += rng.normal(0.0, 0.01, 3)
    turn = rng.normal(0.0, np.deg2rad(1.0) / np.sqrt(3.0), 3)
    it.T_tcp_tool[:3, :3] = it.T_tcp_tool[:3, :3] @ rotation_from_rotvec(turn)
    return it


def path_joints(q_start=Q_START, corners=None, per_leg: int = 10):
    chain = chain_of(machine())
    T = nominal_machine().tcp(q_start)
    here, qs = np.zeros(3), [q_start]
    for corner in folded_corners() if corners is None else corners:
        for share in (np.arange(per_leg) + 1.0) / per_leg:
            wanted = pose(T[:3, :3], T[:3, 3] + T[:3, :3] @ (here + share * (corner - here)))
            found = inverse_nearest(chain, wanted, qs[-1])
            if found.q_rad is None:
                raise ValueError(found.reason)
            qs.append(found.q_rad)
        here = corner
    return np.array(qs)


def odometry_run(
    true: TrueMachine, qs, rng, sigma_m=3e-4, affine_frac=0.0015, clock_s=0.0, step_s=0.15, play_rad=NO_PLAY
):
    t_s = step_s * np.arange(len(qs))
    sides = play_sides(qs, play_rad, np.ones(6))
    joints = JointTrack(t_s, qs, play_sides(qs, NOMINAL_PLAY, np.ones(6)))
    camera_t = t_s[2:-2]
    true_qs = (
        joints.joints_at(camera_t + clock_s)[0]
        - 0.5 * play_rad * JointTrack(t_s, sides).joints_at(camera_t + clock_s)[0]
    )
    Ts = np.array([true.tcp(q) @ true.T_tcp_cam for q in true_qs])
    Ts = inverse_pose(Ts[0]) @ Ts
    warp = np.eye(3) + rng.normal(0.0, affine_frac, (3, 3))
    for T in Ts[1:]:
        T[:3, 3] = warp @ T[:3, 3] + rng.normal(0.0, sigma_m, 3)
        T[:3, :3] = rotation_from_rotvec(rng.normal(0.0, np.deg2rad(0.02), 3)) @ T[:3, :3]
    return OdometryRun(CameraTrack(camera_t, Ts), joints)


@dataclass
class Scene:
    """A true machine in front of an OOI."""

    true: TrueMachine
    T_base_ooi: np.ndarray
    rng: np.random.Generator
    sigma_m: float = 2e-4
    play_rad: np.ndarray = field(default_factory=lambda: NO_PLAY)

    def tool(self, q):
        """Where the tool is when every joint has come from below."""
        return inverse_pose(self.T_base_ooi) @ self.true.tcp(q - 0.5 * self.play_rad) @ self.true.T_tcp_tool

    def look(self, q) -> LookAt:
        T_cam_tool = inverse_pose(self.true.T_tcp_cam) @ self.true.T_tcp_tool
        T_cam_ooi = inverse_pose(self.true.tcp(q - 0.5 * self.play_rad) @ self.true.T_tcp_cam) @ self.T_base_ooi
        noisy = []
        for T in (T_cam_tool, T_cam_ooi):
            turn = rotation_from_rotvec(self.rng.normal(0.0, np.deg2rad(0.02), 3))
            noisy.append(pose(turn @ T[:3, :3], T[:3, 3] + self.rng.normal(0.0, self.sigma_m, 3)))
        covariance = np.diag(np.square([np.deg2rad(0.02)] * 3 + [self.sigma_m] * 3))
        return LookAt(q, *noisy, covariance, covariance, np.ones(6))


def scene(
    rng, distance_m=0.4, lateral_m=(0.05, -0.04), true: TrueMachine | None = None, q_start=Q_START, play_rad=NO_PLAY
) -> Scene:
    it = true or drawn_machine(rng)
    turn = rotation_from_rotvec(rng.normal(0.0, np.deg2rad(1.0), 3))
    T_ooi_tool = pose(turn, np.array([*lateral_m, GOAL[2, 3] + distance_m]))
    T_base_tool = it.tcp(q_start - 0.5 * play_rad) @ it.T_tcp_tool
    return Scene(it, T_base_tool @ inverse_pose(T_ooi_tool), rng, play_rad=play_rad)
