"""The compensation as the plans use it: made once from a machine file's effects, then only asked."""

from dataclasses import dataclass, replace

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.effects.arm import Arm, arm_of
from machine.effects.encoders import angles_at_rest
from machine.effects.entries import EffectEntry, pack_effects
from machine.effects.kernel import BACKLASH, BIAS, DEADBAND, DEADBAND_LOST
from machine.effects.layout import LENGTH_A, LENGTH_D, SAG, ParameterSets
from machine.effects.seen import camera_mount
from machine.effects.structure import tcp_poses
from machine.inverse import inverse_nearest
from machine.kinematics import tcp_pose
from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec, rotvec_from_rotation
from server.calibration.joint_estimate import JointPrior
from server.calibration.kinematic_errors import ErrorPrior
from server.compensation.effects import EffectsByUse, sort_effects
from server.errors import SettingsError

# What can be wrong with a compensation.


class CompensationError(SettingsError):
    """A diagnosis that must not be used, or effects that cannot be compensated."""


DIAGNOSED_SIGMA_LEFT_FRAC = 0.35  # of a class's spread that is left once a number was diagnosed


# Where the tool really is for given encoders, and which nominal pose has it where it should be. Pure functions.

ITERATIONS_MAX = 12
CLOSE_M, CLOSE_RAD = 1e-6, 1e-7


@dataclass(frozen=True, slots=True)
class DiagnosedArm:
    """The arm with its effects: geometry and masses of the file, parameters of the effects."""

    arm: Arm
    effect_parameters: ParameterSets

    def tcp_poses(self, qs: Array, sides: Array | None = None) -> Array:
        """Ts_base_tcp (m, 4, 4) at rest with encoders at qs (m, n) [rad].

        Model: q = encoder map inverted, less half the play on the side where the link rests, bent by gravity.
        Args:  sides: +1 after a way up, when what the encoder turns lies half a width behind (m, n) or (n,), 0 unknown.
        """
        behind = None if sides is None else -np.asarray(sides, dtype=float)
        return tcp_poses(
            self.arm, self.effect_parameters, angles_at_rest(self.effect_parameters, np.atleast_2d(qs), behind)
        )


def diagnosed_arm(machine: Machine, entries: tuple[EffectEntry, ...]) -> DiagnosedArm:
    """The arm of a machine with these effects."""
    return DiagnosedArm(arm_of(machine), pack_effects(entries, len(machine.joints)))


def nominal_goal(diagnosed: DiagnosedArm, chain: Chain, q_now: Array, T_goal: Array, sides: Array) -> Array:
    """The pose that the nominal model has where the diagnosed machine has T_goal: what a planner is given.

    Model:  T_nominal <- correction T_nominal until the diagnosed machine at its joints stands at the goal; converges by
            the ratio of the errors, a few per cent a round.
    Args:   q_now: encoders (n,) [rad], the branch to stay in. T_goal: (4, 4). sides: from which each joint comes (n,).
    Raises: CompensationError: out of reach, or no convergence.
    """
    q, T_nominal = q_now, tcp_pose(chain, q_now)
    for _ in range(ITERATIONS_MAX):
        T_there = diagnosed.tcp_poses(q[None], sides)[0]
        away = T_goal[:3, 3] - T_there[:3, 3]
        turn = rotvec_from_rotation(T_goal[:3, :3] @ T_there[:3, :3].T)
        if np.linalg.norm(away) < CLOSE_M and np.linalg.norm(turn) < CLOSE_RAD:
            return T_nominal
        T_nominal = pose(rotation_from_rotvec(turn) @ T_nominal[:3, :3], T_nominal[:3, 3] + away)
        found = inverse_nearest(chain, T_nominal, q)
        if found.q_rad is None:
            raise CompensationError(f"compensated goal: {found.reason}")
        q = found.q_rad
    raise CompensationError("compensated goal: the diagnosed machine cannot reach it; check the size of its effects")


def mount_of(diagnosed: DiagnosedArm, machine: Machine) -> Array:
    """T_tcp_cam_left (4, 4) of the diagnosed machine."""
    return camera_mount(diagnosed.effect_parameters, machine.T_tcp_cam_left)


@dataclass(frozen=True, slots=True)
class Compensation:
    """A diagnosed machine; its effects by use: compensated and not."""

    machine: Machine
    diagnosed_arm: DiagnosedArm
    effects_by_use: EffectsByUse

    def tcp_poses(self, qs: Array, sides: Array) -> Array:
        """True Ts_base_tcp (m, 4, 4) for encoders (m, n), as diagnosed; `sides` in the play, -1 to 1."""
        return self.diagnosed_arm.tcp_poses(qs, sides)

    def nominal_goal(self, chain: Chain, q_now: Array, T_goal: Array, sides: Array) -> Array:
        """What to plan for so that the tool ends at T_goal; `sides` (n,): where the joints then rest in their play."""
        return nominal_goal(self.diagnosed_arm, chain, q_now, T_goal, sides)

    @property
    def T_tcp_cam(self) -> Array:
        """The camera's diagnosed mount (4, 4)."""
        return mount_of(self.diagnosed_arm, self.machine)

    @property
    def knows_mount(self) -> bool:
        """Whether the camera's rotation was diagnosed."""
        return any(effect.name == "hand_eye_rotation" for effect in self.effects_by_use.compensated)

    def first_stall(self, guessed: Array) -> Array:
        """Stall (n,) [rad] before any was seen: the diagnosed dead band over the gain, the guess elsewhere."""
        dead = self.diagnosed_arm.effect_parameters.joint_parameters[0][:, [DEADBAND, DEADBAND_LOST]].sum(axis=1)
        kp = np.array([joint.kp_frac_per_rad for joint in self.machine.joints])
        return np.where(dead > 0.0, dead / kp, guessed)

    def believed_machine(self) -> Machine:
        """The machine with diagnosed lengths and zeros in its table, for the joint estimate to start from."""
        P = self.diagnosed_arm.effect_parameters.joint_parameters[0]
        joints = [
            replace(
                joint,
                a_m=float(joint.a_m + row[LENGTH_A]),
                d_m=float(joint.d_m + row[LENGTH_D]),
                theta_offset_rad=float(joint.theta_offset_rad - row[BIAS]),
            )
            for joint, row in zip(self.machine.joints, P, strict=True)
        ]
        return replace(self.machine, joints=tuple(joints), T_tcp_cam_left=self.T_tcp_cam)

    def believed_errors(self) -> ErrorPrior:
        """What the joint estimate believes of sag and play: the diagnosed sizes, where there are any."""
        P, plain = self.diagnosed_arm.effect_parameters.joint_parameters[0], ErrorPrior()
        sag, play = P[:, SAG], P[:, BACKLASH]
        mean_sag, sigma_sag = _prior_with_diagnosed_sizes(plain.mean_compliance, plain.sigma_compliance, sag)
        mean_play, sigma_play = _prior_with_diagnosed_sizes(plain.mean_play_rad, plain.sigma_play_rad, play)
        return replace(
            plain,
            mean_compliance=mean_sag,
            sigma_compliance=sigma_sag,
            mean_play_rad=mean_play,
            sigma_play_rad=sigma_play,
        )

    def joint_prior(self) -> JointPrior:
        """The prior of the joint estimate around the diagnosed machine."""
        return JointPrior(kinematic_errors=self.believed_errors())


def _prior_with_diagnosed_sizes(
    mean: tuple[float, ...], sigma: tuple[float, ...], found: Array
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Means and standard deviations with the diagnosed sizes (n,) in place of the class's; 0 was not diagnosed.

    Of a joint that has none by its class, a share of what was found: with a sigma of 0 the estimate would drop it.
    """
    n = len(found)
    m, s = (np.concatenate([values, np.zeros(n)])[:n] for values in (mean, sigma))
    known = found != 0.0
    new_mean = np.where(known, found, m)
    new_sigma = np.where(known, DIAGNOSED_SIGMA_LEFT_FRAC * np.where(s > 0.0, s, np.abs(found)), s)
    return tuple(float(x) for x in new_mean), tuple(float(x) for x in new_sigma)


def compensation_of(machine: Machine, entries: tuple[EffectEntry, ...]) -> Compensation:
    """The compensation of a machine with these effects."""
    sorted_effects = sort_effects(entries)
    return Compensation(machine, diagnosed_arm(machine, sorted_effects.compensated), sorted_effects)
