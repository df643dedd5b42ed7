"""Odometry poses of one run, and the camera track that calibration wants."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from server.calibration.contracts import CameraTrack
from server.camera.contracts import FrameReport
from server.vision.contracts import OdometryPose, OdometryStatus

SIGMA_MAX_M = (
    0.010  # chords of a calibration are 80 mm: what is known no better (another brick, two motions) says nothing
)
POSES_MAX = 180 * 60  # as long as encoders are kept to match them with, at 60 pairs a second


@dataclass(slots=True)
class TrackCollector:
    """Takes reports of one odometry run while it lasts; the newest POSES_MAX poses are kept."""

    run: int
    poses: deque[OdometryPose] = field(default_factory=lambda: deque(maxlen=POSES_MAX))
    _offsets_ns: deque[int] = field(default_factory=lambda: deque(maxlen=POSES_MAX))

    def add(self, report: FrameReport) -> None:
        """Keep this report's odometry, if it has one and it is of this run."""
        if report.odometry is not None and report.odometry_run == self.run:
            self.poses.append(report.odometry)
            self._offsets_ns.append(report.t_exposure_mapped_ns - report.observation.t_exposure_ns)

    def track(self) -> CameraTrack:
        """The camera's own trajectory without poses that are lost or hardly known.

        One clock offset serves the whole track (the median of those seen): an offset that is refined on the way
        would bend the track's time.
        """
        kept = [pose for pose in self.poses if _is_known(pose)]
        if not kept:
            return CameraTrack(t_s=np.zeros(0), Ts_vo_cam=np.zeros((0, 4, 4)))
        offset_ns = int(np.median(self._offsets_ns))
        t_s = np.array([(pose.t_exposure_ns + offset_ns) * 1e-9 for pose in kept])
        return CameraTrack(t_s=t_s, Ts_vo_cam=np.stack([pose.T_vo_cam for pose in kept]))


def _is_known(pose: OdometryPose) -> bool:
    return (
        pose.status is not OdometryStatus.LOST
        and float(np.linalg.eigvalsh(pose.covariance[3:, 3:])[-1]) < SIGMA_MAX_M**2
    )
