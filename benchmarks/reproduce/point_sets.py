"""Table 3 and Figure 8: the odometry's points, laid onto the encoders' by the paper's match; how far they are off."""

from dataclasses import dataclass

import numpy as np

from benchmarks.reproduce.paper_tables import PointSetErrors
from machine.rotations import Array
from server.calibration.chords import positions_at
from server.calibration.contracts import CameraTrack, EncoderTrack
from server.calibration.hybrid_mixture import register_poses
from server.calibration.trajectory_matching_paper import DEFAULT_MIXTURE_SETTINGS, coarse_frame_alignment, evenly_along


@dataclass(frozen=True, slots=True)
class PointSets:
    """Matched odometry (n, 3), the encoders' TCP at the same stamps (n, 3), base axes [m]; gaps to the nearest."""

    matched: Array
    encoder: Array
    nearest: Array

    @property
    def at_once(self) -> PointSetErrors:
        """Point against point of the same stamp: clock offset and lag are in it."""
        return _errors(self.matched - self.encoder)

    @property
    def nearest_point(self) -> PointSetErrors:
        """Point against the nearest point of the other set."""
        return _errors(self.nearest)

    def notes(self) -> dict[str, float | str]:
        """Both as flat numbers for a saved case [mm]."""
        found: dict[str, float | str] = {}
        for name, errors in (("at once", self.at_once), ("nearest", self.nearest_point)):
            for axis, mean, maximum in zip("xyz", errors.mean_mm, errors.maximum_mm, strict=True):
                found |= {f"{name} mean {axis}": mean, f"{name} max {axis}": maximum}
        return found


def matched_sets(camera: CameraTrack, encoder: EncoderTrack, R_tcp_cam_assumed: Array) -> PointSets:
    """The paper's match (eq. 20) applied to the whole track, as its Figure 8 draws it."""
    Ts_vo, Ts_tcp = camera.Ts_vo_cam, encoder.Ts_base_tcp
    picks_vo, picks_tcp = (evenly_along(Ts[:, :3, 3], 100) for Ts in (Ts_vo, Ts_tcp))
    R_cfa = coarse_frame_alignment(Ts_tcp[0, :3, :3], R_tcp_cam_assumed, Ts_vo[0, :3, :3])
    match = register_poses(
        points_x=Ts_tcp[picks_tcp, :3, 3],
        Rs_x=Ts_tcp[picks_tcp, :3, :3] @ R_tcp_cam_assumed,
        points_y=Ts_vo[picks_vo, :3, 3] @ R_cfa.T,
        Rs_y=R_cfa @ Ts_vo[picks_vo, :3, :3],
        settings=DEFAULT_MIXTURE_SETTINGS,
    )
    matched = Ts_vo[:, :3, 3] @ (match.R_x_y @ R_cfa).T + match.t_x_y
    at_stamps, inside = positions_at(camera.t_s, encoder.t_s, Ts_tcp[:, :3, 3])
    near = np.linalg.norm(matched[:, None] - Ts_tcp[None, :, :3, 3], axis=2).argmin(axis=1)
    return PointSets(matched[inside], at_stamps[inside], matched - Ts_tcp[near, :3, 3])


def _errors(gaps_m: Array) -> PointSetErrors:
    sizes = 1e3 * np.abs(gaps_m)
    (mx, my, mz), (hx, hy, hz) = sizes.mean(axis=0).tolist(), sizes.max(axis=0).tolist()
    return PointSetErrors((mx, my, mz), (hx, hy, hz))
