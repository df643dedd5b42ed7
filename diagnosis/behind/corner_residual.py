"""What arm, camera and markers leave of the corners that were seen, in units of their noise: the residual of a cell."""

from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.link_angles import Path, link_angles, without_encoders
from diagnosis.log.nominal import Nominal
from diagnosis.noise.of_a_day import DayNoise, day_noise
from diagnosis.noise.of_corners import CornerNoise, groups_of
from machine.effects.layout import CAMERA_PARAMETER_COLUMNS, READOUT, ParameterSets
from machine.effects.seen import camera_mount, seen_corners, tool_place, true_times
from machine.effects.structure import tcp_poses
from machine.rotations import Array, rotation_from_rotvec
from machine.targets import Marker

FINITE_DIFFERENCE_STEP = 1e-4
RESIDUAL_CLIP_PX = 1e3
# Of a column: what is left of one below it is what a step of the object's place is wrong by
PROJECTED_COLUMN_MIN_FRAC = 1e-3


@dataclass(frozen=True, slots=True)
class Frames:
    """Corners by frame: t_s (m,) on the PLC's clock as best known, pixels (m, 2 eyes, markers, 4, 2), NaN unseen.

    `frame_axis_group` (N,): frame and axis of each number that was seen.
    """

    t_s: Array
    corners_px: Array
    markers: tuple[Marker, ...]
    frame_axis_group: NDArray[np.int64]

    @property
    def frame_of_each(self) -> NDArray[np.int64]:
        """The frame of each number that was seen (N,)."""
        return np.nonzero(np.isfinite(self.corners_px))[0]

    @classmethod
    def with_groups(cls, t_s: Array, pixels: Array, markers: tuple[Marker, ...]) -> Self:
        """With its groups."""
        return cls(t_s, pixels, markers, groups_of(pixels))


@dataclass(frozen=True, slots=True)
class CornerResidual:
    """Whitened corners (sets, N): measured less foreseen, the OOI's place in the base fitted each time.

    `fits_clock_offset`: the delay of the camera's stamps is fitted as well, since its clock's offset is not
    given. `layout_noise`: of the markers' places on their object by `layout_m` each, the same in all frames.
    """

    nominal_machine: Nominal
    camera_frames: Frames
    marker_carrier: Literal["tool", "ooi"]
    encoder_paths: tuple[Path, ...]
    path_index: NDArray[np.int64]
    t_start_s: float
    T_base_ooi: Array
    nuisance_jacobian: Array
    noise: CornerNoise
    fits_clock_offset: bool = False
    layout_m: float = 0.0
    layout_noise: DayNoise | None = None

    def __call__(self, sets: ParameterSets) -> Array:
        """One row per set."""
        plain = without_encoders(sets)
        white = self.noise.whiten(self.nuisance_jacobian.T, self.camera_frames.frame_axis_group).T
        arms: dict[bytes, Array] = {}
        rows = [self._unwhitened_residual(sets, plain, k, white, arms) for k in range(sets.set_count)]
        out = self.noise.whiten(np.array(rows), self.camera_frames.frame_axis_group)
        return out if self.layout_noise is None else self.layout_noise.whiten(out)

    def with_layout(self, base: ParameterSets) -> Self:
        """With markers that are each off their place by `layout_m`, and turned by that over half a side."""
        if self.layout_m == 0.0:
            return self
        plain, markers = without_encoders(base), self.camera_frames.markers
        Ts = self.poses(base, plain, 0, 0.0)
        here = self.corner_differences_px(plain, 0, Ts, None, self.T_base_ooi)
        columns = []
        for k, marker in enumerate(markers):
            for row in np.diag(np.repeat((self.layout_m, 2.0 * self.layout_m / marker.side_m), 3)):
                moved = replace(marker, T_on_marker=marker.T_on_marker @ small_motion(row))
                other = replace(
                    self, camera_frames=replace(self.camera_frames, markers=(*markers[:k], moved, *markers[k + 1 :]))
                )
                columns.append(other.corner_differences_px(plain, 0, Ts, None, self.T_base_ooi) - here)
        return replace(self, layout_noise=day_noise(self.placement_free_columns(np.array(columns).T)))

    def _unwhitened_residual(
        self, sets: ParameterSets, plain: ParameterSets, k: int, white: Array, arms: dict[bytes, Array]
    ) -> Array:
        """Not yet whitened (N,); `white`: the whitened nuisance (N, 6 or 7), which the parameters do not change."""
        later = bool(sets.machine_parameters[k, READOUT])
        T = self.poses(sets, plain, k, 0.0, arms=arms)
        T_later = self.poses(sets, plain, k, 0.01, arms=arms) if later else None
        if self.marker_carrier == "tool":
            return self.corner_differences_px(plain, k, T, T_later, tool_place(sets, self.T_base_ooi, k))
        residual = self.corner_differences_px(plain, k, T, T_later, self.T_base_ooi)
        if self.nuisance_jacobian.shape[1] == 0:
            return residual
        moved = self.T_base_ooi @ small_motion(-self._best_nuisance_change(white, residual)[:6])
        residual = self.corner_differences_px(plain, k, T, T_later, moved)
        return np.asarray(residual - self.nuisance_jacobian @ self._best_nuisance_change(white, residual), dtype=float)

    def _best_nuisance_change(self, white: Array, residual: Array) -> Array:
        """Change of the OOI's place, and of the clock (6 or 7,), that explains most of a residual (N,) [px]."""
        return least_squares(white, self.noise.whiten(residual[None], self.camera_frames.frame_axis_group)[0])

    def placement_free_columns(self, columns: Array) -> Array:
        """Columns (N, k) [px, by any number], white as the residual, without what a change of the OOI's place does."""
        white = self.noise.whiten(columns.T, self.camera_frames.frame_axis_group).T
        if self.marker_carrier == "tool" or self.nuisance_jacobian.shape[1] == 0:
            return white
        own = self.noise.whiten(self.nuisance_jacobian.T, self.camera_frames.frame_axis_group).T
        left = white - own @ np.linalg.lstsq(own, white, rcond=None)[0]
        return left * (np.linalg.norm(left, axis=0) > PROJECTED_COLUMN_MIN_FRAC * np.linalg.norm(white, axis=0))

    def poses(
        self,
        sets: ParameterSets,
        plain: ParameterSets,
        k: int,
        later_s: float,
        more_rad: Array | float = 0.0,
        arms: dict[bytes, Array] | None = None,
    ) -> Array:
        """Ts_cam_base (m, 4, 4), or Ts_cam_tcp where the tool is looked at. `more_rad`: on top of the angles (n,).

        `arms`: Ts_tcp_base that were computed for other sets, which most sets share: they differ in the camera only.
        """
        mount = self.nominal_machine.T_tcp_cam_left
        if mount is None or self.nominal_machine.arm is None:
            return np.tile(np.eye(4), (len(self.camera_frames.t_s), 1, 1))
        T_cam_tcp = np.asarray(np.linalg.inv(camera_mount(sets, mount, k)), dtype=float)
        if self.marker_carrier == "tool":
            return np.tile(T_cam_tcp, (len(self.camera_frames.t_s), 1, 1))
        machine = sets.machine_parameters[k].copy()
        machine[CAMERA_PARAMETER_COLUMNS] = 0.0
        key = sets.joint_parameters[k].tobytes() + machine.tobytes() + np.float64(later_s).tobytes()
        Ts_tcp_base = None if arms is None else arms.get(key)
        if Ts_tcp_base is None:
            t = true_times(sets, self.camera_frames.t_s, self.t_start_s, k) + later_s
            q = link_angles(self.encoder_paths, sets, k, self.path_index, t) + more_rad
            Ts_tcp_base = np.asarray(np.linalg.inv(tcp_poses(self.nominal_machine.arm, plain, q, k)), dtype=float)
            if arms is not None:
                arms[key] = Ts_tcp_base
        return np.asarray(T_cam_tcp @ Ts_tcp_base, dtype=float)

    def moved_by_each(self, sets: ParameterSets) -> Array:
        """How far an angle more at each joint takes each number (n, N) [px/rad]: the residual of such an error."""
        plain = without_encoders(sets)

        def left(more_rad: Array | float) -> Array:
            return self.corner_differences_px(
                plain, 0, self.poses(sets, plain, 0, 0.0, more_rad), None, self.T_base_ooi
            )

        here = left(0.0)
        return (
            np.array([here - left(more_rad) for more_rad in FINITE_DIFFERENCE_STEP * np.eye(self.nominal_machine.n)])
            / FINITE_DIFFERENCE_STEP
        )

    def corner_differences_px(
        self, plain: ParameterSets, k: int, Ts: Array, later: Array | None, T_object: Array
    ) -> Array:
        """Measured less foreseen of the corners that were seen (N,) [px]."""
        camera = self.nominal_machine.camera
        if camera is None:
            return np.zeros(0)
        after = None if later is None else later @ T_object
        corners = seen_corners(plain, camera, self.camera_frames.markers, Ts @ T_object, after, 0.01, k)
        foreseen = np.stack([corners.left_px, corners.right_px], axis=1)
        seen = np.isfinite(self.camera_frames.corners_px)
        return np.clip(
            np.nan_to_num((self.camera_frames.corners_px - foreseen)[seen], nan=RESIDUAL_CLIP_PX),
            -RESIDUAL_CLIP_PX,
            RESIDUAL_CLIP_PX,
        )


def least_squares(A: Array, r: Array) -> Array:
    """Least squares of r (N,) by the columns of A (N, k), (k,)."""
    return np.asarray(np.linalg.solve(A.T @ A + 1e-9 * np.eye(A.shape[1]), A.T @ r), dtype=float)


def small_motion(x: Array) -> Array:
    """A step (6,) [m, rad] as a transform (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_rotvec(x[3:]), x[:3]
    return T


def nuisance_of(placed: CornerResidual, base: ParameterSets) -> Array:
    """Change of the residual with the OOI's place (N, 6), per m and rad in its own axes; where the clock's offset is
    unknown (N, 7) with that, per s.
    """
    plain = without_encoders(base)
    Ts = placed.poses(base, plain, 0, 0.0)
    at = placed.corner_differences_px(plain, 0, Ts, None, placed.T_base_ooi)
    steps = [
        placed.corner_differences_px(plain, 0, Ts, None, placed.T_base_ooi @ small_motion(FINITE_DIFFERENCE_STEP * row))
        for row in np.eye(6)
    ]
    if placed.fits_clock_offset:
        steps.append(
            placed.corner_differences_px(
                plain, 0, placed.poses(base, plain, 0, FINITE_DIFFERENCE_STEP), None, placed.T_base_ooi
            )
        )
    return np.array([(step - at) / FINITE_DIFFERENCE_STEP for step in steps]).T
