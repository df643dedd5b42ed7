"""When a look is complete: collects fresh pairs and says what they are worth. No clock, no process."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from server.calibration.contracts import CameraTrack
from server.camera.contracts import FrameReport, PoseSourceName
from server.vision.contracts import Look, LookStatus, OdometryPose, OdometryStatus, PairObservation

Average = Callable[[Sequence[PairObservation]], Look]

FAILED_BATCHES_MAX = 2  # a look that fails by what it shows, not by motion, gets one more batch of pairs

# Chords are 80 mm: a path known worse (another brick, two motions) does not help a calibration
POSITION_SIGMA_MAX_M = 0.010
POSES_MAX = 180 * 60  # as long as encoders are kept to match them with, at 60 pairs a second


@dataclass(slots=True)
class TrackCollector:
    """Takes reports of one odometry run while it lasts; the newest POSES_MAX poses are kept."""

    odometry_run: int
    poses: deque[OdometryPose] = field(default_factory=lambda: deque(maxlen=POSES_MAX))
    _offsets_ns: deque[int] = field(default_factory=lambda: deque(maxlen=POSES_MAX))

    def add(self, report: FrameReport) -> None:
        """Keep this report's odometry, if it has one and it is of this run."""
        if report.odometry is not None and report.odometry_run == self.odometry_run:
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
        and float(np.linalg.eigvalsh(pose.covariance[3:, 3:])[-1]) < POSITION_SIGMA_MAX_M**2
    )


@dataclass(slots=True)
class LookCollector:
    """Takes reports until the newest `n_pairs` give a good look.

    A pair counts when it was exposed after `t_from_ns`, by the wanted pose source, and its images are healthy. A look
    ends with a pair whose whole picture was searched: a second marker of the same id may have come since the last time.
    Pairs after the last search go when an unusable pair follows them.
    """

    n_pairs: int
    t_from_ns: int
    pose_source: PoseSourceName
    average_pairs: Average
    best_look: Look | None = None
    n_unusable: int = 0
    last_warning: str = ""
    _pairs: list[PairObservation] = field(default_factory=list)
    _new: int = 0
    _failed: int = 0
    _unsure: int = 0  # newest pairs, since the last search of the whole picture

    def add(self, report: FrameReport) -> Look | None:
        """The finished look, or None when more pairs are wanted."""
        if report.t_exposure_mapped_ns < self.t_from_ns or report.pose_source != self.pose_source:
            return None
        if not report.fit_for_look:
            self._reject_frame_report(report)
            return None
        self._pairs = [*self._pairs, report.observation][-self.n_pairs :]
        self._new += 1
        self._unsure = 0 if report.observation.fully_searched else self._unsure + 1
        if len(self._pairs) < self.n_pairs or self._new < self._wanted_new() or self._unsure > 0:
            return None
        return self._try_finish_look()

    def _reject_frame_report(self, report: FrameReport) -> None:
        self.n_unusable += 1
        self.last_warning = report.warnings[0]
        self._pairs = self._pairs[: max(0, len(self._pairs) - self._unsure)]
        self._new = max(0, self._new - self._unsure)
        self._unsure = 0

    def _wanted_new(self) -> int:
        """After a first try, half a batch of new pairs before the next one."""
        return self.n_pairs if self.best_look is None else max(1, self.n_pairs // 2)

    def _try_finish_look(self) -> Look | None:
        self._new = 0
        self.best_look = look = self.average_pairs(tuple(self._pairs))
        if look.status is LookStatus.OK:
            return look
        if look.status is not LookStatus.NOT_AT_REST:
            self._failed += 1
        return look if self._failed >= FAILED_BATCHES_MAX else None

    def at_timeout(self, timeout_s: float, stream_text: str) -> Look:
        """What to answer when time is up: the last verdict, or why there were too few pairs."""
        if self.best_look is not None:
            return self.best_look
        if self.n_unusable:
            reason = f"{self.n_unusable} pairs were unusable: {self.last_warning}"
        else:
            reason = stream_text or "the camera stream is too slow or silent"
        text = f"{len(self._pairs)} of {self.n_pairs} pairs within {timeout_s:.1f} s; {reason}"
        return Look(
            status=LookStatus.NO_IMAGES,
            reason=text,
            n_pairs=len(self._pairs),
            t_first_ns=self._pairs[0].t_exposure_ns if self._pairs else 0,
            t_last_ns=self._pairs[-1].t_exposure_ns if self._pairs else 0,
        )
