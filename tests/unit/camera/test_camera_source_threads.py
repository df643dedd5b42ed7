"""Whatever a camera or OpenCV does to a reading thread, the thread goes on, says why, and asks again."""

import time

import cv2
import numpy as np
import pytest
from camera_stand_in import CameraStandIn, jpeg_of, part_of, picture

from server.camera.contracts import StereoSource
from server.camera.sources.capture import Capture
from server.camera.sources.device import DeviceStereoSource
from server.camera.sources.http import HttpStereoSource
from server.camera.sources.live import LiveSource
from server.camera.sources.multipart import MultipartParser
from server.camera.sources.settings import DeviceSource, HttpSource

WAIT_S = 10.0


def told(source: StereoSource, text: str) -> bool:
    """Whether it says so in time."""
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end and text not in source.state:
        time.sleep(0.002)
    return text in source.state


class Raising:
    """A device that can be opened, and raises in one of its methods the first time."""

    def __init__(self, at: str) -> None:
        self.at, self.asked = at, {cv2.CAP_PROP_POS_MSEC: 1e3}
        self.released = 0

    def _maybe(self, at: str) -> None:
        if at == self.at:
            self.at = ""
            raise cv2.error(f"{at}: unknown C++ exception")

    def isOpened(self) -> bool:
        return True

    def set(self, propId: int, value: float, /) -> bool:
        self.asked[propId] = value
        return True

    def get(self, propId: int, /) -> float:
        if propId == cv2.CAP_PROP_POS_MSEC:
            self._maybe("stamp")
        return self.asked.get(propId, 0.0)

    def read(self) -> tuple[bool, np.ndarray]:
        self._maybe("read")
        return True, np.stack([picture(60, 180), np.full((60, 160), 128, np.uint8)], axis=2)

    def release(self) -> None:
        self.released += 1


@pytest.mark.parametrize("at", ["open", "read", "stamp"])
def test_a_device_in_which_opencv_raises_is_opened_again(at: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LiveSource, "BACK_OFF_S", (0.3, 8.0))
    device = Raising(at)

    def opened(_index: int | str) -> Capture:
        device._maybe("open")
        return device

    source = DeviceStereoSource(DeviceSource(0, width_px=160, height_px=60, rate_hz=30.0, pixel_format="YUYV"), opened)
    assert told(source, f"{at}: unknown C++ exception")
    assert source.read(WAIT_S) is not None
    source.close()
    assert device.released == (1 if at == "open" else 2)


def test_a_defect_while_reading_a_stream_ends_the_connection_and_not_the_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken, raised = MultipartParser.feed, []

    def feed(parser: MultipartParser, data: bytes, t_mono_ns: int) -> object:
        if not raised:
            raised.append(1)
            raise ZeroDivisionError("a defect")
        return taken(parser, data, t_mono_ns)

    monkeypatch.setattr(MultipartParser, "feed", feed)
    with CameraStandIn() as camera:
        source = HttpStereoSource(HttpSource(camera.url))
        camera.send(part_of(jpeg_of(picture(90, 90)), 1, 1))
        assert told(source, "ZeroDivisionError")
        camera.hang_up()
        camera.send(part_of(jpeg_of(picture(90, 90)), 2, 2))
        frame = source.read(WAIT_S)
        source.close()
    assert frame is not None
    assert frame.sequence == 2
