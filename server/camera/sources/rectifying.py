"""A source whose pairs come out rectified: nothing behind it knows that the camera has a lens."""

from dataclasses import replace

from server.camera.contracts import StereoFrame, StereoSource
from server.camera.errors import StreamError
from server.camera.rectification import Rectifier, rectification_of
from server.camera.sources.settings import RectifiedSource


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
