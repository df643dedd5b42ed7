"""How well the keyframes are known, jointly: an error taken over from an older keyframe counts once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.rotations import skew
from server.vision.contracts import Array
from server.vision.odometry_sensitivity import N_SHARED_ERRORS, Sensitivity

# How long the rolling shutter takes from the first row to the last: given, or learned from the motion itself.

READOUT_SIGMA_S = 0.010  # before anything was seen: from a global shutter to that of a 60 Hz camera
READOUT_MAX_S = 0.040
NEW_INFORMATION_FRAC = 0.1  # of a pair's information: the rest it shares with its neighbours (same patches, same map)
READOUT_SIGMA_MIN_S = 2e-4  # never surer: later pairs must be able to correct it


@dataclass(frozen=True, slots=True)
class Readout:
    """Readout [s] and its sigma [s]; sigma 0 = given, never changed."""

    value_s: float
    sigma_s: float

    @property
    def size_s(self) -> float:
        """How long it may well be: what a wrong velocity is multiplied by."""
        return float(np.hypot(self.value_s, self.sigma_s))

    def updated_with_step(self, step_s: float, information: float) -> "Readout":
        """After one more pair said: change it by `step_s`, with this information [1/s^2]."""
        if self.sigma_s == 0.0 or information <= 0.0:
            return self
        known, fresh = self.sigma_s**-2, NEW_INFORMATION_FRAC * information
        value = float(np.clip(self.value_s + step_s * fresh / (known + fresh), -READOUT_MAX_S, READOUT_MAX_S))
        return Readout(value, max(float((known + fresh) ** -0.5), READOUT_SIGMA_MIN_S))


def readout_of(readout_s: float | None) -> Readout:
    """As given, or unknown."""
    return Readout(0.0, READOUT_SIGMA_S) if readout_s is None else Readout(readout_s, 0.0)


class KeyframeCovariances:
    """Joint covariance of all keyframes' shared errors (12 each: pose by left perturbation in vo, velocity)."""

    def __init__(self) -> None:
        self._joint = np.zeros((0, 0))

    def pose_covariance(self, found: Sensitivity) -> Array:
        """What the keyframes' errors amount to in a pose that was fitted to their points, (6, 6)."""
        gain, places = self._gain_and_indices(found)
        return gain @ self._joint[np.ix_(places, places)] @ gain.T

    def add(self, covariance: Array, found: Sensitivity | None, twist_sigma: Array) -> None:
        """A new keyframe at a pose with this covariance (6, 6); `found`: the keyframes that it was fitted to."""
        old = len(self._joint)
        joint = np.zeros((old + N_SHARED_ERRORS, old + N_SHARED_ERRORS))
        joint[:old, :old] = self._joint
        joint[old : old + 6, old : old + 6] = covariance
        joint[old + 6 :, old + 6 :] = np.diag(twist_sigma**2)
        if found is not None:
            gain, places = self._gain_and_indices(found)
            joint[old : old + 6, :old] = gain @ self._joint[places]
            joint[:old, old : old + 6] = joint[old : old + 6, :old].T
        self._joint = joint

    def set_twist(self, number: int, twist_sigma: Array) -> None:
        """A keyframe's velocity became better known."""
        start = N_SHARED_ERRORS * number + 6
        self._joint[start : start + 6, start : start + 6] = np.diag(twist_sigma**2)

    def replace_poses(self, numbers: Sequence[int], joint: Array, Ts_vo_key: Array) -> None:
        """After an adjustment: joint covariance (6 k, 6 k) of these keyframes' poses given the first of them.

        Model:   error = rigid motion by the first one's error, plus the adjustment's own (zero for the first).
        Args:    Ts_vo_key: their poses (k, 4, 4).
        """
        first = N_SHARED_ERRORS * numbers[0]
        moved = np.zeros((6 * len(numbers), 6))
        for row, T in enumerate(Ts_vo_key):
            moved[6 * row : 6 * row + 6] = np.eye(6)
            moved[6 * row + 3 : 6 * row + 6, :3] = -skew(T[:3, 3] - Ts_vo_key[0, :3, 3])
        places = np.concatenate([np.arange(N_SHARED_ERRORS * n, N_SHARED_ERRORS * n + 6) for n in numbers])
        others = np.setdiff1d(np.arange(len(self._joint)), places)
        crossed = moved @ self._joint[first : first + 6][:, others]
        inside = moved @ self._joint[first : first + 6, first : first + 6] @ moved.T + joint
        self._joint[np.ix_(places, others)] = crossed
        self._joint[np.ix_(others, places)] = crossed.T
        self._joint[np.ix_(places, places)] = inside

    def twist_sigma(self, number: int) -> Array:
        """Sigma (6,) of one keyframe's velocity."""
        start = N_SHARED_ERRORS * number + 6
        return np.sqrt(np.diag(self._joint)[start : start + 6])

    def remove(self, number: int) -> None:
        """Forget a keyframe."""
        kept = np.delete(
            np.arange(len(self._joint)), np.arange(N_SHARED_ERRORS * number, N_SHARED_ERRORS * (number + 1))
        )
        self._joint = self._joint[np.ix_(kept, kept)]

    @staticmethod
    def _gain_and_indices(found: Sensitivity) -> tuple[Array, NDArray[np.int64]]:
        gain = found.of_keyframes.transpose(1, 0, 2).reshape(6, -1)
        places = np.concatenate(
            [np.arange(N_SHARED_ERRORS * n, N_SHARED_ERRORS * (n + 1)) for n in found.keyframe_indices]
        )
        return np.asarray(gain, float), np.asarray(places, np.int64)
