"""From settings to a source."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from recording.clock import mono_ns
from server.camera.contracts import StereoFrame, StereoSource
from server.camera.errors import CameraError, StreamError
from server.camera.rectification import Rectifier, rectification_of
from server.camera.sources.ahead import AheadSource
from server.camera.sources.capture import require_intra_coded
from server.camera.sources.device import DeviceStereoSource
from server.camera.sources.folder import EurocStereoSource, FolderStereoSource
from server.camera.sources.http import HttpStereoSource
from server.camera.sources.recorded import RecordingStereoSource
from server.camera.sources.rtsp import RtspStereoSource
from server.camera.sources.settings import (
    DeviceSource,
    EurocSource,
    FileSource,
    FolderSource,
    HttpSource,
    RecordingSource,
    RectifiedSource,
    RtspSource,
    SourceSettings,
)
from server.camera.sources.side_by_side import split_side_by_side
from server.camera.sources.stamped import Pacing


class RectifyingSource:
    """Wraps another source. Only pairs that are taken are rectified; those passed over cost nothing."""

    def __init__(self, source: StereoSource, settings: RectifiedSource) -> None:
        self._source = source
        self._rectifier = Rectifier(settings.rig, rectification_of(settings.rig, settings.rate_hz))
        self._refusal = ""

    @property
    def skipped(self) -> int:
        """Pairs passed over so far because newer ones were there."""
        return self._source.skipped

    @property
    def state(self) -> str:
        """The source's, or why its pictures do not fit the calibration."""
        return self._refusal or self._source.state

    @property
    def ended(self) -> bool:
        """Whether no pair will ever come again."""
        return self._source.ended

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The newest pair, rectified; a pair of another size than the calibration's is passed over."""
        frame = self._source.read(timeout_s)
        if frame is None:
            return None
        try:
            left, right = self._rectifier.rectify(frame.left, frame.right)
        except StreamError as error:
            self._refusal = str(error)
            return None
        self._refusal = ""
        return replace(frame, left=left, right=right)

    def close(self) -> None:
        """Let go of the camera."""
        self._source.close()
        self._rectifier.close()


class FileStereoSource:
    """A video file played once at its own rate; every frame is given out, stamped by its number over the rate."""

    def __init__(self, settings: FileSource) -> None:
        self._path = settings.path
        self._capture = cv2.VideoCapture(settings.path) if Path(settings.path).is_file() else None
        if self._capture is None or not self._capture.isOpened():
            raise CameraError(f"video file '{settings.path}' cannot be opened; give a file of side-by-side frames")
        if not settings.accept_inter_coded:
            require_intra_coded(self._capture, f"video file '{settings.path}'")
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


def open_source(settings: SourceSettings) -> StereoSource:
    """The source that the settings describe.

    Raises: CameraError when a file or folder cannot be used; a camera that is not there yet is waited for.
    """
    match settings:
        case RectifiedSource():
            return RectifyingSource(open_source(settings.source), settings)
        case HttpSource():
            return HttpStereoSource(settings)
        case DeviceSource():
            return DeviceStereoSource(settings)
        case RtspSource():
            return RtspStereoSource(settings)
        case FileSource():
            return FileStereoSource(settings)
        case FolderSource():
            return FolderStereoSource(settings)
        case EurocSource():
            return EurocStereoSource(settings)
        case RecordingSource():
            return RecordingStereoSource(settings)


def open_ahead(settings: SourceSettings) -> StereoSource:
    """The same, a camera's next pair decoded while the one before is worked on; stored pairs wait for a read.

    Raises: CameraError as open_source.
    """
    source = open_source(settings)
    camera = settings.source if isinstance(settings, RectifiedSource) else settings
    return AheadSource(source) if isinstance(camera, HttpSource | DeviceSource | RtspSource) else source
