"""The next pair is decoded while the one before is worked on; none is lost, none comes twice, none grows old."""

import threading
import time

import numpy as np
import pytest

from recording.clock import mono_ns
from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError
from server.camera.sources.ahead import AheadSource
from server.camera.sources.opening import open_ahead
from server.camera.sources.settings import HttpSource, RecordingSource

LONG_S = 20.0  # for what comes at once unless it never comes
EYE = np.zeros((2, 2), np.uint8)


class Numbered:
    """A camera that always has a newer pair; each one says when it was taken from the camera."""

    def __init__(self, decoding_s: float = 0.0) -> None:
        self.begun = threading.Semaphore(0)
        self.read_times_s: list[float] = []
        self.failing, self.silent, self.closed = False, False, False
        self.skipped, self.state, self.ended = 7, "dusty", False
        self._decoding_s = decoding_s

    def read(self, timeout_s: float) -> StereoFrame | None:
        if self.silent:
            time.sleep(min(timeout_s, 0.01))
            return None
        if self.failing:
            self.failing = False
            raise CameraError("camera: unplugged")
        self.read_times_s.append(time.monotonic())
        self.begun.release()
        time.sleep(self._decoding_s)
        number = len(self.read_times_s)
        return StereoFrame(EYE, EYE, number, mono_ns(), number)

    def close(self) -> None:
        self.closed = True


def test_the_next_pair_is_begun_before_it_is_asked_for() -> None:
    camera = Numbered()
    source = AheadSource(camera)
    try:
        first = source.read(LONG_S)
        assert first is not None
        assert first.sequence == 1
        for _ in range(2):  # nobody asked for the second
            assert camera.begun.acquire(timeout=LONG_S)
        assert not camera.begun.acquire(timeout=0.2)  # and the third waits until the second is taken
        pairs = [source.read(LONG_S) for _ in range(50)]
        assert [pair.sequence for pair in pairs if pair is not None] == list(range(2, 52))
    finally:
        source.close()


def test_a_slow_worker_gets_a_pair_that_has_not_waited_all_that_time() -> None:
    camera = Numbered(decoding_s=0.01)
    source, ages_s = AheadSource(camera), []
    try:
        for _ in range(12):
            pair = source.read(LONG_S)
            assert pair is not None
            ages_s.append(time.monotonic() - camera.read_times_s[pair.sequence - 1])
            time.sleep(0.25)
    finally:
        source.close()
    assert np.median(ages_s[4:]) < 0.15  # 0.25 if it were begun as soon as the one before was taken


def test_a_silent_camera_gives_nothing_in_time_and_is_closed() -> None:
    camera = Numbered()
    camera.silent = True
    source = AheadSource(camera)
    assert source.read(0.05) is None
    assert source.read(0.0) is None
    assert (source.skipped, source.state, source.ended) == (7, "dusty", False)
    source.close()
    assert camera.closed
    assert not any(thread.name == "camera-ahead" for thread in threading.enumerate())


def test_what_the_camera_raises_reaches_the_worker_once() -> None:
    camera = Numbered()
    camera.failing = True
    source = AheadSource(camera)
    try:
        with pytest.raises(CameraError, match="unplugged"):
            source.read(LONG_S)
        pair = source.read(LONG_S)
        assert pair is not None
        assert pair.sequence == 1
    finally:
        source.close()


def test_cameras_are_read_ahead_and_stored_pairs_are_not(tmp_path) -> None:
    camera = open_ahead(HttpSource("http://127.0.0.1:9/none"))
    try:
        assert isinstance(camera, AheadSource)
        assert "connecting" in camera.state or "again" in camera.state
    finally:
        camera.close()
    with pytest.raises(CameraError):
        open_ahead(RecordingSource(str(tmp_path / "none.mcap")))
