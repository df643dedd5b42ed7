"""What the arm leaves of measured points, in units of their noise: the residual that a cell is searched by."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.link_angles import BACKLASH_SIDES, Path, link_angles, without_encoders
from diagnosis.behind.points import PointData, PointFit, fit_points, modelled_points
from diagnosis.log.nominal import Nominal
from diagnosis.noise.of_points import PointNoise, instants_of
from machine.effects import kernel
from machine.effects.encoders import true_angles
from machine.effects.layout import ParameterSets
from machine.effects.seen import true_times
from machine.poses import transform_points
from machine.rotations import Array

FINITE_DIFFERENCE_STEP_RAD = 1e-4


@dataclass(frozen=True, slots=True)
class PointResidual:
    """Residuals (sets, 3 m) of measured points in units of the floor; unknown frame and places are fitted each time.

    Axes: radial, tangential and up about the base's upright, since a slewing arm oscillates across more than it bends.
    `known_model_error_m`: (3 m,), what the machine's model is known to be wrong by. `t_start_s`: of the recording,
    where the tracker's clock may be off (see `true_times`); None where that is the camera's.
    """

    nominal_machine: Nominal
    measured_points: PointData
    encoder_paths: tuple[Path, ...]
    path_index: NDArray[np.int64]
    noise: PointNoise
    known_model_error_m: Array | None = None
    t_start_s: float | None = None

    def __call__(self, sets: ParameterSets) -> Array:
        """One row per set."""
        return self.noise.whiten(self.metres(sets))

    def metres(self, sets: ParameterSets) -> Array:
        """The same (sets, 3 m) before it is weighed [m]."""
        plain = without_encoders(sets)
        rows = []
        for k in range(sets.set_count):
            data = replace(self.measured_points, q=self._angles_on_backlash_side(sets, plain, k))
            rows.append(_about_upright(fit_points(self.nominal_machine, plain, data, k), data.xyz).ravel())
        return np.array(rows) - (0.0 if self.known_model_error_m is None else self.known_model_error_m)

    def reach_m(self, sets: ParameterSets) -> Array:
        """How far each point is from the base's upright (m,)."""
        data = replace(self.measured_points, q=self._true_joint_angles(sets, 0))
        T = fit_points(self.nominal_machine, without_encoders(sets), data, 0).T_base_tracker
        p = transform_points(T, data.xyz)
        return np.hypot(p[:, 0], p[:, 1])

    def moved_by_each(self, sets: ParameterSets) -> Array:
        """How far an angle more at each joint takes each point (n, m, 3) [m/rad]: radial, tangential, up."""
        plain, data = without_encoders(sets), replace(self.measured_points, q=self._true_joint_angles(sets, 0))
        found = fit_points(self.nominal_machine, plain, data)
        here = modelled_points(self.nominal_machine, plain, data, found.positions_in_link_m)
        moved = [
            modelled_points(self.nominal_machine, plain, replace(data, q=data.q + more_rad), found.positions_in_link_m)
            - here
            for more_rad in FINITE_DIFFERENCE_STEP_RAD * np.eye(self.nominal_machine.n)
        ]
        return np.array(
            [
                _about_upright(replace(found, residual_m=shift / FINITE_DIFFERENCE_STEP_RAD), self.measured_points.xyz)
                for shift in moved
            ]
        )

    def _true_joint_angles(self, sets: ParameterSets, which: int, side: float = 0.0) -> Array:
        if not self.encoder_paths:
            return true_angles(sets, self.measured_points.q, which)
        when = (
            self.measured_points.time_or_pose_index
            if self.t_start_s is None
            else true_times(sets, self.measured_points.time_or_pose_index, self.t_start_s, which)
        )
        return link_angles(self.encoder_paths, sets, which, self.path_index, when, side)

    def _angles_on_backlash_side(self, sets: ParameterSets, plain: ParameterSets, which: int) -> Array:
        """Angles (m, n) with each course begun on that side of the plays that its points are nearer to.

        Why: until a joint has gone through its play, it is unknown where in it the link stands. Begun in the middle,
             fifteen points of three hundred spoke against a play that was there.
        """
        if not self.encoder_paths or not sets.joint_parameters[which, :, kernel.BACKLASH].any():
            return self._true_joint_angles(sets, which)
        sided = np.stack([self._true_joint_angles(sets, which, side) for side in BACKLASH_SIDES])
        unsure = np.ptp(sided, axis=0).max(axis=1) > 0.0
        off = [
            fit_points(self.nominal_machine, plain, replace(self.measured_points, q=q), which).residual_m[unsure]
            for q in sided
        ]
        by_path = [
            np.bincount(self.path_index[unsure], (residual**2).sum(axis=1), len(self.encoder_paths)) for residual in off
        ]
        nearest = np.argmin(by_path, axis=0)[self.path_index]
        return sided[nearest, np.arange(len(nearest))]


def unweighted_residual(
    nominal: Nominal, data: PointData, paths: tuple[Path, ...], at: NDArray[np.int64]
) -> PointResidual:
    """The residual [m] of those points that lie in a path, `at` (m,), -1 in none; of poses at rest all are in one."""
    kept = at >= 0
    data = PointData(data.q[kept], data.point_index[kept], data.xyz[kept], data.time_or_pose_index[kept])
    plain = PointNoise(np.ones(3), 0.0, np.zeros(len(data.xyz)), instants_of(data.time_or_pose_index))
    return PointResidual(nominal, data, paths, at[kept], plain)


def _about_upright(found: PointFit, xyz: Array) -> Array:
    """The residual (m, 3) of points measured at xyz (m, 3) as radial, tangential, up."""
    T, r = found.T_base_tracker, found.residual_m
    p = transform_points(T, xyz)
    azimuth = np.arctan2(p[:, 1], p[:, 0])
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.stack([c * r[:, 0] + s * r[:, 1], c * r[:, 1] - s * r[:, 0], r[:, 2]], axis=1)
