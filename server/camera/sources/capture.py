"""What we ask of OpenCV's VideoCapture, and a thread that keeps its newest picture."""

import logging
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError, StreamError
from server.camera.sources.newest import Newest

BACK_OFF_FIRST_S = 0.5
BACK_OFF_MAX_S = 8.0
CLOSE_S = 3.0

_log = logging.getLogger(__name__)

Picture = NDArray[Any]


class Capture(Protocol):
    """cv2.VideoCapture, as far as it is used."""

    def isOpened(self) -> bool:
        """Whether it can be read."""
        ...

    def set(self, propId: int, value: float, /) -> bool:
        """Ask for a property; what came of it must be read back."""
        ...

    def get(self, propId: int, /) -> float:
        """A property as it is."""
        ...

    def read(self) -> tuple[bool, Picture]:
        """The next picture."""
        ...

    def release(self) -> None:
        """Let go."""
        ...


class CapturedSource(ABC):
    """Reads a capture in a thread that keeps the newest picture; decoding waits until it is read.

    A capture that is lost, or that cannot be opened, is opened again with back-off. How one is opened, stamped and
    decoded is the subclass's matter.
    """

    def __init__(self, subject: str) -> None:
        self._subject = subject
        self._newest: Newest[tuple[Picture, int, int, int, int]] = Newest()
        self._stop = threading.Event()
        self._state = f"{subject}: opening"
        self._connection = 0
        self._thread = threading.Thread(target=self._run, name="camera-capture", daemon=True)

    @property
    def skipped(self) -> int:
        """Pictures replaced by newer ones before they were taken."""
        return self._newest.skipped

    @property
    def state(self) -> str:
        """Empty while pictures arrive."""
        return self._state

    @property
    def ended(self) -> bool:
        """Never: a camera may always come back."""
        return False

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The newest pair; a picture that cannot be decoded is passed over and reported in `state`."""
        taken = self._newest.take(timeout_s)
        if taken is None:
            return None
        picture, t_exposure_ns, t_receive_ns, sequence, connection = taken
        try:
            left, right = self._eyes(picture)
        except StreamError as error:
            self._state = f"{self._subject}: {error}"
            return None
        self._state = ""
        return StereoFrame(left, right, t_exposure_ns, t_receive_ns, sequence, connection)

    def close(self) -> None:
        """Let go of the camera."""
        self._stop.set()
        self._thread.join(CLOSE_S)

    @abstractmethod
    def _open(self) -> Capture:
        """A capture that gives what was requested.

        Raises: CameraError: it cannot be opened, or gives something else.
        """

    @abstractmethod
    def _stamp(self, capture: Capture) -> tuple[int, int]:
        """Exposure and arrival [ns] of the picture just read."""

    @abstractmethod
    def _eyes(self, picture: Picture) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Left and right grey views of a picture."""

    def _run(self) -> None:
        back_off_s = BACK_OFF_FIRST_S
        while not self._stop.is_set():
            try:
                back_off_s = BACK_OFF_FIRST_S if self._captured() else back_off_s
                reason = f"{self._subject}: gives no pictures"
            except CameraError as error:
                reason = str(error)
            except (
                Exception
            ) as error:  # outermost loop of the thread: whatever OpenCV raises, the camera is tried again
                _log.exception(self._subject)
                reason = f"{self._subject}: {error!r}"
            if self._stop.is_set():
                return
            self._state = f"{reason}; trying again"
            _log.info("%s in %.1f s", self._state, back_off_s)
            self._stop.wait(back_off_s)
            back_off_s = min(2.0 * back_off_s, BACK_OFF_MAX_S)

    def _captured(self) -> bool:
        """One capture from its opening to its end; whether it gave any picture."""
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
            t_exposure_ns, t_receive_ns = self._stamp(capture)
            sequence += 1
            self._newest.put((picture, t_exposure_ns, t_receive_ns, sequence, self._connection))
        return sequence > 0


OpenCapture = Callable[[int | str], Capture]
