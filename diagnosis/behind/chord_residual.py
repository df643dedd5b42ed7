"""What the arm leaves of the lengths of odometry's chords, in units of their noise: the residual of a cell."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.link_angles import Path, link_angles, without_encoders
from diagnosis.log.nominal import Nominal
from machine.effects.layout import ODOMETRY_SCALE, ParameterSets
from machine.effects.seen import camera_mount, true_times
from machine.effects.structure import tcp_poses
from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class ChordResidual:
    """Whitened lengths (sets, m): odometry's less the encoders'.

    Each chord from `start_s` to `end_s` (m,), stamps on the PLC's clock as best known, in paths `at` (m,); `length_m`
    (m,) as odometry has it.
    """

    nominal_machine: Nominal
    encoder_paths: tuple[Path, ...]
    at: NDArray[np.int64]
    start_s: Array
    end_s: Array
    length_m: Array
    t_start_s: float
    sigma_m: float = 1.0

    def __call__(self, sets: ParameterSets) -> Array:
        """One row per set."""
        plain = without_encoders(sets)
        rows = [self.length_m - self.predicted_lengths(sets, plain, k) for k in range(sets.set_count)]
        return np.array(rows) / self.sigma_m

    def predicted_lengths(self, sets: ParameterSets, plain: ParameterSets, k: int) -> Array:
        """Lengths (m,) [m] that one set foresees."""
        ends = [self._camera_positions(sets, plain, k, t) for t in (self.start_s, self.end_s)]
        scale = 1.0 + float(sets.machine_parameters[k, ODOMETRY_SCALE])
        return scale * np.linalg.norm(ends[1] - ends[0], axis=1)

    def _camera_positions(self, sets: ParameterSets, plain: ParameterSets, k: int, stamps_s: Array) -> Array:
        """The camera in the base (m, 3)."""
        arm, mount = self.nominal_machine.arm, self.nominal_machine.T_tcp_cam_left
        if arm is None or mount is None:
            return np.zeros((len(stamps_s), 3))
        t = true_times(sets, stamps_s, self.t_start_s, k)
        Ts_base_tcp = tcp_poses(arm, plain, link_angles(self.encoder_paths, sets, k, self.at, t), k)
        return (Ts_base_tcp @ camera_mount(sets, mount, k))[:, :3, 3]
