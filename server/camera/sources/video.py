"""Stereo pairs from a video device or a video file: side-by-side frames by OpenCV's VideoCapture."""

import threading
import time
from pathlib import Path

import cv2
import numpy as np

from server.camera.contracts import DeviceSource, FileSource, StereoFrame
from server.camera.errors import CameraError
from server.camera.sources.newest import Newest
from server.camera.sources.pacing import Pacing
from server.camera.sources.side_by_side import split_side_by_side

DEVICE_RETRY_S = 1.0


class DeviceStereoSource:
    """A UVC camera. Frames are stamped when they arrive: such a camera gives no exposure time by VideoCapture."""

    def __init__(self, settings: DeviceSource) -> None:
        self._settings = settings
        self._newest: Newest[StereoFrame] = Newest()
        self._stop = threading.Event()
        self._state = f"camera device {settings.index}: opening"
        self._thread = threading.Thread(target=self._run, name="camera-device", daemon=True)
        self._thread.start()

    @property
    def skipped(self) -> int:
        """Frames replaced by newer ones before they were taken."""
        return self._newest.skipped

    @property
    def state(self) -> str:
        """Empty while frames arrive."""
        return self._state

    @property
    def ended(self) -> bool:
        """Never: a device may be plugged in again."""
        return False

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The newest pair."""
        return self._newest.take(timeout_s)

    def close(self) -> None:
        """Let go of the device."""
        self._stop.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        connection = 0
        while not self._stop.is_set():
            connection += 1
            capture = cv2.VideoCapture(self._settings.index)
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._settings.width_px)
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._settings.height_px)
            capture.set(cv2.CAP_PROP_FPS, self._settings.rate_hz)
            self._grab(capture, connection)
            capture.release()
            self._state = f"camera device {self._settings.index} gives no frames; trying again"
            self._stop.wait(DEVICE_RETRY_S)

    def _grab(self, capture: cv2.VideoCapture, connection: int) -> None:
        sequence = 0
        while not self._stop.is_set():
            good, picture = capture.read()
            if not good:
                return
            t_ns, sequence = time.monotonic_ns(), sequence + 1
            left, right = split_side_by_side(np.asarray(picture, np.uint8))
            self._state = ""
            self._newest.put(StereoFrame(left, right, t_ns, t_ns, sequence, connection))


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
        return StereoFrame(left, right, t_exposure_ns, time.monotonic_ns(), self._sequence)

    def close(self) -> None:
        """Let go of the file."""
        if self._capture is not None:
            self._capture.release()
