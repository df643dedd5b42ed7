"""Stereo pairs from a UVC device such as a ZED2: side-by-side frames by V4L2, size, rate and format read back."""

import cv2
import numpy as np
from numpy.typing import NDArray

from recording.clock import mono_ns, suspended_ns
from server.camera.errors import CameraError, StreamError
from server.camera.sources.capture import Capture, CapturedSource, OpenCapture, Picture
from server.camera.sources.settings import DeviceSource
from server.camera.sources.side_by_side import decode_side_by_side, split_side_by_side
from server.vision.contracts import Image

FRAME_RATE_ERROR_MAX_FRAC = 0.02


def open_v4l2(index: int | str) -> Capture:
    """The device by its number or path."""
    return cv2.VideoCapture(index, cv2.CAP_V4L2)


class DeviceStereoSource(CapturedSource):
    """A UVC camera. Frames carry the driver's own stamp (when the frame came in over USB, mostly by CLOCK_MONOTONIC,
    so it is put on our clock; another one is mapped as any camera's).

    OpenCV's conversion is off: MJPG arrives as JPEG bytes and is decoded straight to grey, YUYV gives its
    luminance; neither makes a detour through colour.
    """

    def __init__(self, settings: DeviceSource, open_capture: OpenCapture = open_v4l2) -> None:
        name = f"/dev/video{settings.index}" if isinstance(settings.index, int) else settings.index
        super().__init__(f"camera device {name}")
        self._settings = settings
        self._open_capture = open_capture
        self._suspended_ns = suspended_ns()  # a resume ends the vision process, so it stays as it is
        self._thread.start()

    def _open(self) -> Capture:
        capture = self._open_capture(self._settings.index)
        try:
            self._ask(capture)
        except CameraError:
            capture.release()
            raise
        return capture

    def _ask(self, capture: Capture) -> None:
        """Ask for format, size and rate, in the order in which V4L2 lets one change the next; read back what came."""
        wanted, subject = self._settings, self._subject
        if not capture.isOpened():
            raise CameraError(f"{subject} cannot be opened; plug it in, close other programs that use it")
        fourcc = cv2.VideoWriter.fourcc(*wanted.pixel_format)
        capture.set(cv2.CAP_PROP_FOURCC, fourcc)
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, wanted.width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.height_px)
        capture.set(cv2.CAP_PROP_FPS, wanted.rate_hz)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 2)  # one being filled, one being read: older ones would only be late
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        size = round(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        rate_hz, given = capture.get(cv2.CAP_PROP_FPS), _fourcc_text(capture.get(cv2.CAP_PROP_FOURCC))
        faults = []
        if size != (wanted.width_px, wanted.height_px):
            asked = f"width_px = {wanted.width_px}, height_px = {wanted.height_px}"
            faults.append(f"{asked}: it gives {size[0]} x {size[1]}")
        if abs(rate_hz - wanted.rate_hz) > FRAME_RATE_ERROR_MAX_FRAC * wanted.rate_hz:
            faults.append(f"rate_hz = {wanted.rate_hz:g}: it gives {rate_hz:g}")
        if given != wanted.pixel_format:
            faults.append(f"pixel_format = '{wanted.pixel_format}': it gives '{given}'")
        if faults:
            raise CameraError(
                f"{subject} refuses [camera] {'; '.join(faults)}. Set what it can do (v4l2-ctl --list-formats-ext), "
                "and use a USB 3 port"
            )

    def _stamp(self, capture: Capture) -> tuple[int, int]:
        now_ns = mono_ns()
        driver_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        stamp_ns = driver_ns + self._suspended_ns if driver_ns > 0 else now_ns  # however old: never made younger
        return stamp_ns, now_ns

    def _split_eyes(self, picture: Picture) -> tuple[Image, Image]:
        wanted = self._settings
        if picture.ndim == 2 and 1 in picture.shape:  # a JPEG's bytes
            left, right = decode_side_by_side(np.ascontiguousarray(picture, np.uint8).reshape(-1))
        else:
            left, right = split_side_by_side(_extract_luminance(picture))
        if left.shape != (wanted.height_px, wanted.width_px // 2):
            raise StreamError(
                f"a picture of {2 * left.shape[1]} x {left.shape[0]} px came; unplug the camera and plug it in"
            )
        return left, right


def _extract_luminance(picture: Picture) -> NDArray[np.uint8]:
    """Grey (h, w) of YUYV (h, w, 2), or a picture that was converted after all."""
    if picture.ndim == 3 and picture.shape[2] == 2:
        return np.asarray(cv2.extractChannel(picture, 0), np.uint8)
    return np.asarray(picture, np.uint8)


def _fourcc_text(number: float) -> str:
    return "".join(chr((int(number) >> shift) & 0xFF) for shift in (0, 8, 16, 24)).strip("\0 ")
