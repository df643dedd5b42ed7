"""Cameras by OpenCV's VideoCapture: what we ask of it, and a source that reads it."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError, StreamError
from server.camera.sources.live import STALL_WARNING_TEXT, LiveSource

Picture = NDArray[Any]
Capture = cv2.VideoCapture
OpenCapture = Callable[[int | str], Capture]
# Codecs that code each picture by itself. Others show damage until the next key frame, and FFmpeg does not report it.
INTRA_CODED_FOURCCS = frozenset({"MJPG", "MPNG", "FFV1"})


def require_intra_coded(capture: Capture, subject: str) -> None:
    """Raises: CameraError: the pictures depend on those before, so damage in one stays in the next, unseen."""
    code = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace").strip("\0 ").upper()
    if code not in INTRA_CODED_FOURCCS:
        raise CameraError(
            f"{subject}: codec '{code or 'unknown'}' hides damaged pictures until the next key frame, and a look may "
            "then be wrong by several mm; set the camera to Motion JPEG, or accept this with [camera] "
            "accept_inter_coded = true"
        )


class CapturedSource(LiveSource[tuple[Picture, int, int, int, int]]):
    """Reads a capture; decoding waits until a picture is read. How one is opened, stamped and decoded is the subclass's
    matter.
    """

    ENDED = "gives no pictures"
    EXPECTED = (CameraError,)

    def __init__(self, subject: str) -> None:
        super().__init__(subject, "opening")

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The newest pair; a picture that cannot be decoded is passed over and reported in `state`."""
        taken = self._newest.take_newest(timeout_s)
        if taken is None:
            return None
        picture, t_exposure_ns, t_receive_ns, sequence, connection = taken
        try:
            left, right = self._split_eyes(picture)
        except StreamError as error:
            self._state = f"{self._subject}: {error}"
            return None
        self._state = ""
        return StereoFrame(left, right, t_exposure_ns, t_receive_ns, sequence, connection)

    @abstractmethod
    def _open(self) -> Capture:
        """A capture that gives what was requested.

        Raises: CameraError: it cannot be opened, or gives something else.
        """

    @abstractmethod
    def _stamp(self, capture: Capture) -> tuple[int, int]:
        """Exposure and arrival [ns] of the picture just read."""

    @abstractmethod
    def _split_eyes(self, picture: Picture) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Left and right grey views of a picture."""

    def _reason(self, error: Exception) -> str:
        return str(error)

    def _connected(self) -> bool:
        capture = self._open()
        try:
            return self._pump(capture)
        finally:
            capture.release()

    def _pump(self, capture: Capture) -> bool:
        """Read until it gives no more; whether it gave any."""
        self._connection += 1
        sequence = 0
        while not self._stop.is_set():
            good, picture = capture.read()
            if not good:
                break
            held_up = self._heartbeat.was_held_up()
            t_exposure_ns, t_receive_ns = self._stamp(capture)
            if held_up and t_exposure_ns == t_receive_ns:  # stamped by arrival
                raise CameraError(f"{self._subject}: {STALL_WARNING_TEXT}")
            sequence += 1
            self._newest.put((picture, t_exposure_ns, t_receive_ns, sequence, self._connection))
        return sequence > 0
