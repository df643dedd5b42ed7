"""Stereo pairs from a video file of side-by-side frames."""

from pathlib import Path

import cv2
import numpy as np

from recording.clock import mono_ns
from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError
from server.camera.sources.pacing import Pacing
from server.camera.sources.settings import FileSource
from server.camera.sources.side_by_side import split_side_by_side


class FileStereoSource:
    """A video file played once at its own rate; every frame is given out, stamped by its number over the rate."""

    def __init__(self, settings: FileSource) -> None:
        self._path = settings.path
        self._capture = cv2.VideoCapture(settings.path) if Path(settings.path).is_file() else None
        if self._capture is None or not self._capture.isOpened():
            raise CameraError(f"video file '{settings.path}' cannot be opened; give a file of side-by-side frames")
        rate_hz = float(self._capture.get(cv2.CAP_PROP_FPS)) or 30.0
        self._pacing = Pacing(rate_hz)
        self._period_ns = int(1e9 / rate_hz)
        self._sequence = 0
        self.skipped = 0
        self.state = ""
        self.ended = False

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The next pair, when it is due."""
        if self.ended or self._capture is None or not self._pacing.wait(timeout_s):
            return None
        good, picture = self._capture.read()
        if not good:
            self.ended, self.state = True, f"video file '{self._path}': end after {self._sequence} frames"
            return None
        left, right = split_side_by_side(np.asarray(picture, np.uint8))
        t_exposure_ns = self._sequence * self._period_ns
        self._sequence += 1
        return StereoFrame(left, right, t_exposure_ns, mono_ns(), self._sequence)

    def close(self) -> None:
        """Let go of the file."""
        if self._capture is not None:
            self._capture.release()
