"""Stereo pairs from a network camera: RTSP over TCP by OpenCV's FFmpeg, opened again with back-off when lost."""

import contextlib
import os
import threading
from collections.abc import Iterator
from urllib.parse import urlsplit

import cv2
import numpy as np

from recording.clock import mono_ns
from server.camera.errors import CameraError
from server.camera.sources.capture import Capture, CapturedSource, OpenCapture, Picture, require_intra_coded
from server.camera.sources.settings import RtspSource
from server.camera.sources.side_by_side import split_side_by_side
from server.shown_address import without_password
from server.vision.contracts import Image

# TCP: a lost UDP packet smears a picture until the next key frame. The rest keeps FFmpeg from holding pictures back.
FFMPEG_OPTIONS = "rtsp_transport;tcp|fflags;nobuffer|flags;low_delay|max_delay;0|reorder_queue_size;0"
FFMPEG_ENV_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"  # the only way into OpenCV's FFmpeg

_OPENING = threading.Lock()


def open_ffmpeg(url: int | str, timeout_s: float) -> Capture:
    """The stream; every wait in it is bounded."""
    limit_ms = round(1e3 * timeout_s)
    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, limit_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, limit_ms]
    with _OPENING, _temporary_ffmpeg_options():
        return cv2.VideoCapture(str(url), cv2.CAP_FFMPEG, limits)


@contextlib.contextmanager
def _temporary_ffmpeg_options() -> Iterator[None]:
    """FFmpeg's options while a stream is opened, and only then: a video file would lose its first frames by them."""
    before = os.environ.get(FFMPEG_ENV_VARIABLE)
    if before is None:  # otherwise the user has set it
        os.environ[FFMPEG_ENV_VARIABLE] = FFMPEG_OPTIONS
    try:
        yield
    finally:
        if before is None:
            del os.environ[FFMPEG_ENV_VARIABLE]


class RtspStereoSource(CapturedSource):
    """A network camera. The thread reads every picture as it comes, so latency does not pile up; the newest is kept.

    Stamps are the stream's own (the camera's RTP clock), which the network does not shake; where they do not advance,
    the time of arrival. A stream that changes from one to the other counts as a new connection, since its clock is new.
    """

    def __init__(self, settings: RtspSource, open_capture: OpenCapture | None = None) -> None:
        address = urlsplit(settings.url)
        if address.scheme not in ("rtsp", "rtsps") or not address.hostname:
            raise CameraError(f"camera url '{without_password(settings.url)}' is not rtsp://host[:port]/path")
        super().__init__(f"camera {without_password(settings.url)}")
        self._settings = settings
        self._open_capture = open_capture or (lambda url: open_ffmpeg(url, settings.timeout_s))
        self._last_ns: int | None = None
        self._by_arrival = False
        self._thread.start()

    def _open(self) -> Capture:
        capture = self._open_capture(self._settings.url)
        if not capture.isOpened():
            capture.release()
            raise CameraError(
                f"{self._subject} gives no stream; check address, user, password and that RTSP is switched on"
            )
        if not self._settings.accept_inter_coded:
            try:
                require_intra_coded(capture, self._subject)
            except CameraError:
                capture.release()
                raise
        self._last_ns, self._by_arrival = None, False
        return capture

    def _stamp(self, capture: Capture) -> tuple[int, int]:
        now_ns = mono_ns()
        if self._by_arrival:
            return now_ns, now_ns
        t_ns, last_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6), self._last_ns
        if last_ns is not None and t_ns <= last_ns:
            self._by_arrival = True
            self._connection += 1
            return now_ns, now_ns
        self._last_ns = t_ns
        return t_ns, now_ns

    def _split_eyes(self, picture: Picture) -> tuple[Image, Image]:
        return split_side_by_side(np.asarray(picture, np.uint8))
