"""A network camera over a real socket: RTSP by TCP, the camera's own stamps, and back again after a loss."""

import time

import cv2
import numpy as np
import pytest
from rtsp_stand_in import RtspStandIn

from server.camera.contracts import StereoFrame
from server.camera.sources.rtsp import RtspStereoSource
from server.camera.sources.settings import RtspSource

pytestmark = [pytest.mark.system, pytest.mark.real_time]

RATE_HZ = 40.0
PERIOD_NS = 25_000_000
WAIT_S = 40.0


def jpeg_of(left_grey: int) -> bytes:
    both = np.full((64, 320, 3), 200, np.uint8)
    both[:, :160] = left_grey
    return cv2.imencode(".jpg", both, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


def test_tcp_stamps_and_reconnection() -> None:
    pictures = [jpeg_of(40 + 2 * (number % 60)) for number in range(120)]
    frames: list[StereoFrame] = []
    with RtspStandIn(pictures, RATE_HZ) as camera:
        source = RtspStereoSource(RtspSource(camera.url, timeout_s=5.0))
        end = time.monotonic() + WAIT_S
        while time.monotonic() < end and not (frames and frames[-1].connection_number == 2):
            frame = source.read(0.2)
            frames += [] if frame is None else [frame]
        source.close()
    assert all("TCP" in transport for transport in camera.transports)
    first = [frame for frame in frames if frame.connection_number == 1]
    assert len(first) > 10
    assert frames[-1].connection_number == 2
    assert source.state == ""
    shifts = set()
    for frame in first:
        number = round(frame.t_exposure_ns / PERIOD_NS)
        assert frame.t_exposure_ns == pytest.approx(number * PERIOD_NS, abs=20_000)  # of the 90 kHz clock, not arrival
        shown = round((float(frame.left.mean()) - 40.0) / 2.0)
        assert frame.left.mean() == pytest.approx(40 + 2 * shown, abs=0.6)
        shifts.add((shown - number) % 60)
        assert frame.right.mean() == pytest.approx(200.0, abs=2.0)
    assert len(shifts) == 1  # stamps belong to their pictures; where they begin is FFmpeg's affair
