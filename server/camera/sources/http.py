"""Stereo pairs from a camera server: multipart JPEG over HTTP, stamped by X-Exposure-Ns and X-Sequence.

A thread reads the stream and keeps the newest complete picture undecoded, so that being late costs no decoding.
"""

import contextlib
import http.client
import logging
import socket
import threading
from dataclasses import dataclass

from recording.clock import mono_ns
from server.camera.contracts import StereoFrame
from server.camera.errors import StreamError
from server.camera.sources.http_opening import open_stream, require_address
from server.camera.sources.multipart import MultipartParser, Part
from server.camera.sources.newest import Newest
from server.camera.sources.settings import HttpSource
from server.camera.sources.side_by_side import decode_side_by_side
from server.shown_address import without_password

SILENCE_S = 2.0  # a camera that says nothing for this long is taken as lost
BACK_OFF_FIRST_S = 0.2
BACK_OFF_MAX_S = 3.0
CHUNK_BYTES = 1 << 18

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Received:
    part: Part
    number: int  # of all that arrived, for a camera that does not count
    connection: int


class HttpStereoSource:
    """Reads one camera stream for as long as it lives; a lost stream is opened again with back-off."""

    def __init__(self, settings: HttpSource) -> None:
        require_address(settings.url)
        self._url = settings.url
        self._subject = f"camera {without_password(settings.url)}"
        self._newest: Newest[_Received] = Newest()
        self._stop = threading.Event()
        self._state = f"{self._subject}: connecting"
        self._connection = 0
        self._counted = 0
        self._bad_pictures = 0
        self._socket: socket.socket | None = None
        self._thread = threading.Thread(target=self._run, name="camera-stream", daemon=True)
        self._thread.start()

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
        """Never: a stream may always come back."""
        return False

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The newest pair; a picture that cannot be decoded is passed over and reported in `state`."""
        received = self._newest.take(timeout_s)
        if received is None:
            return None
        part = received.part
        try:
            left, right = decode_side_by_side(part.body)
        except StreamError as error:
            self._bad_pictures += 1
            self._state = f"{self._subject}: {error} ({self._bad_pictures} so far)"
            return None
        return StereoFrame(
            left=left,
            right=right,
            t_exposure_ns=part.t_header_ns if part.t_exposure_ns is None else part.t_exposure_ns,
            t_receive_mono_ns=part.t_header_ns,
            sequence=received.number if part.sequence is None else part.sequence,
            connection=received.connection,
        )

    def close(self) -> None:
        """End the reading thread, in the midst of its waiting if need be."""
        self._stop.set()
        with contextlib.suppress(OSError):  # gone already
            if self._socket is not None:
                self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join(SILENCE_S + 1.0)

    def _run(self) -> None:
        back_off_s = BACK_OFF_FIRST_S
        while not self._stop.is_set():
            try:
                if self._stream():
                    back_off_s = BACK_OFF_FIRST_S
                reason = "the camera ended the stream"
            except (OSError, http.client.HTTPException, StreamError) as error:
                reason = str(error) or type(error).__name__
            except Exception as error:  # outermost loop of the thread: whatever a camera sends, it is asked again
                _log.exception(self._subject)
                reason = repr(error)
            if self._stop.is_set():
                return
            self._state = f"{self._subject}: {reason}; trying again"
            _log.info("%s in %.1f s", self._state, back_off_s)
            self._stop.wait(back_off_s)
            back_off_s = min(2.0 * back_off_s, BACK_OFF_MAX_S)

    def _stream(self) -> bool:
        """Read one connection to its end; the name is resolved again each time. Returns whether any picture came."""
        with open_stream(self._url, SILENCE_S, self._take_socket) as response:
            self._connection += 1
            return self._read_parts(response)

    def _take_socket(self, opened: socket.socket) -> None:
        """The one that is read from now on, so that `close` can end a wait in it."""
        self._socket = opened

    def _read_parts(self, response: http.client.HTTPResponse) -> bool:
        parser = MultipartParser((response.headers.get_boundary() or "").encode(errors="replace"))
        any_part = False
        while not self._stop.is_set():
            data = response.read1(CHUNK_BYTES)
            if not data:
                return any_part
            for part in parser.feed(data, mono_ns()):
                any_part = True
                self._state = ""
                self._counted += 1
                self._newest.put(_Received(part, self._counted, self._connection))
        return any_part
