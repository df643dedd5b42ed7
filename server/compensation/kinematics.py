"""Where the tool really is for given encoders, and which nominal pose has it where it should be. Pure functions."""

from dataclasses import dataclass

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.effects.arm import Arm, arm_of
from machine.effects.encoders import angles_at_rest
from machine.effects.entries import EffectEntry, pack
from machine.effects.layout import ParameterSets
from machine.effects.seen import camera_mount
from machine.effects.structure import tcp_poses
from machine.inverse import inverse_nearest
from machine.kinematics import tcp_pose
from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec, rotvec_from_rotation
from server.compensation.errors import CompensationError

ROUNDS_MAX = 12
CLOSE_M, CLOSE_RAD = 1e-6, 1e-7


@dataclass(frozen=True, slots=True)
class DiagnosedArm:
    """The arm with its effects: geometry and masses of the file, parameters of the effects."""

    arm: Arm
    sets: ParameterSets

    def tcp_poses(self, qs: Array, sides: Array | None = None) -> Array:
        """Ts_base_tcp (m, 4, 4) at rest with encoders at qs (m, n) [rad].

        Model: q = encoder map inverted, less half the play on the side where the link rests, bent by gravity.
        Args:  sides: +1 after a way up, when what the encoder turns lies half a width behind (m, n) or (n,), 0 unknown.
        """
        behind = None if sides is None else -np.asarray(sides, dtype=float)
        return tcp_poses(self.arm, self.sets, angles_at_rest(self.sets, np.atleast_2d(qs), behind))


def diagnosed_arm(machine: Machine, entries: tuple[EffectEntry, ...]) -> DiagnosedArm:
    """The arm of a machine with these effects."""
    return DiagnosedArm(arm_of(machine), pack(entries, len(machine.joints)))


def nominal_goal(diagnosed: DiagnosedArm, chain: Chain, q_now: Array, T_goal: Array, sides: Array) -> Array:
    """The pose that the nominal model has where the diagnosed machine has T_goal: what a planner is given.

    Model:  T_nominal <- correction T_nominal until the diagnosed machine at its joints stands at the goal; converges by
            the ratio of the errors, a few per cent a round.
    Args:   q_now: encoders (n,) [rad], the branch to stay in. T_goal: (4, 4). sides: from which each joint comes (n,).
    Raises: CompensationError: out of reach, or no convergence.
    """
    q, T_nominal = q_now, tcp_pose(chain, q_now)
    for _ in range(ROUNDS_MAX):
        T_there = diagnosed.tcp_poses(q[None], sides)[0]
        away = T_goal[:3, 3] - T_there[:3, 3]
        turn = rotvec_from_rotation(T_goal[:3, :3] @ T_there[:3, :3].T)
        if np.linalg.norm(away) < CLOSE_M and np.linalg.norm(turn) < CLOSE_RAD:
            return T_nominal
        T_nominal = pose(rotation_from_rotvec(turn) @ T_nominal[:3, :3], T_nominal[:3, 3] + away)
        found = inverse_nearest(chain, T_nominal, q)
        if found.q is None:
            raise CompensationError(f"compensated goal: {found.reason}")
        q = found.q
    raise CompensationError("compensated goal: the diagnosed machine cannot reach it; check the size of its effects")


def mount_of(diagnosed: DiagnosedArm, machine: Machine) -> Array:
    """T_tcp_cam_left (4, 4) of the diagnosed machine."""
    return camera_mount(diagnosed.sets, machine.T_tcp_cam_left)
