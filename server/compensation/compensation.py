"""The compensation as the plans use it: made once from a machine file's effects, then only asked."""

from dataclasses import dataclass, replace

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.effects.entries import EffectEntry
from machine.effects.kernel import BACKLASH, BIAS, DEADBAND, DEADBAND_LOST
from machine.effects.layout import LENGTH_A, LENGTH_D, SAG
from machine.rotations import Array
from server.calibration.joint_estimate import JointPrior
from server.calibration.kinematic_errors import ErrorPrior
from server.compensation.effects import Sorted, sort_effects
from server.compensation.kinematics import DiagnosedArm, diagnosed_arm, mount_of, nominal_goal

FOUND_SHARE = 0.35  # of a class's spread that is left once a number was diagnosed


@dataclass(frozen=True, slots=True)
class Compensation:
    """A diagnosed machine. `sorted`: its effects, compensated and not."""

    machine: Machine
    diagnosed: DiagnosedArm
    sorted: Sorted

    def tcp_poses(self, qs: Array, sides: Array) -> Array:
        """True Ts_base_tcp (m, 4, 4) for encoders (m, n), as diagnosed; `sides` in the play, -1 to 1."""
        return self.diagnosed.tcp_poses(qs, sides)

    def nominal_goal(self, chain: Chain, q_now: Array, T_goal: Array, sides: Array) -> Array:
        """What to plan for so that the tool ends at T_goal; `sides` (n,): where the joints then rest in their play."""
        return nominal_goal(self.diagnosed, chain, q_now, T_goal, sides)

    @property
    def T_tcp_cam(self) -> Array:
        """The camera's diagnosed mount (4, 4)."""
        return mount_of(self.diagnosed, self.machine)

    @property
    def knows_mount(self) -> bool:
        """Whether the camera's rotation was diagnosed."""
        return any(one.name == "hand_eye_rotation" for one in self.sorted.used)

    def first_stall(self, guessed: Array) -> Array:
        """Stall (n,) [rad] before any was seen: the diagnosed dead band over the gain, the guess elsewhere."""
        dead = self.diagnosed.sets.joint[0][:, [DEADBAND, DEADBAND_LOST]].sum(axis=1)
        kp = np.array([joint.kp_frac_per_rad for joint in self.machine.joints])
        return np.where(dead > 0.0, dead / kp, guessed)

    def believed_machine(self) -> Machine:
        """The machine with diagnosed lengths and zeros in its table, for the joint estimate to start from."""
        P = self.diagnosed.sets.joint[0]
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
        P, plain = self.diagnosed.sets.joint[0], ErrorPrior()
        sag, play = P[:, SAG], P[:, BACKLASH]
        mean_sag, sigma_sag = _believed(plain.mean_compliance, plain.sigma_compliance, sag)
        mean_play, sigma_play = _believed(plain.mean_play_rad, plain.sigma_play_rad, play)
        return replace(
            plain,
            mean_compliance=mean_sag,
            sigma_compliance=sigma_sag,
            mean_play_rad=mean_play,
            sigma_play_rad=sigma_play,
        )

    def joint_prior(self) -> JointPrior:
        """The prior of the joint estimate around the diagnosed machine."""
        return JointPrior(errors=self.believed_errors())


def _believed(
    mean: tuple[float, ...], sigma: tuple[float, ...], found: Array
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Means and standard deviations with the diagnosed sizes (n,) in place of the class's; 0 was not diagnosed.

    Of a joint that has none by its class, a share of what was found: with a sigma of 0 the estimate would drop it.
    """
    n = len(found)
    m, s = (np.concatenate([values, np.zeros(n)])[:n] for values in (mean, sigma))
    known = found != 0.0
    new_mean = np.where(known, found, m)
    new_sigma = np.where(known, FOUND_SHARE * np.where(s > 0.0, s, np.abs(found)), s)
    return tuple(float(x) for x in new_mean), tuple(float(x) for x in new_sigma)


def compensation_of(machine: Machine, entries: tuple[EffectEntry, ...]) -> Compensation:
    """The compensation of a machine with these effects."""
    sorted_effects = sort_effects(entries)
    return Compensation(machine, diagnosed_arm(machine, sorted_effects.used), sorted_effects)
