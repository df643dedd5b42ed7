"""Devices, network cameras, data sets and recordings: right pictures, right stamps, clear faults."""

import os
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_stand_in import jpeg_of, picture
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set
from rig_samples import SIZE_PX, brown_rig

from recording.clock import mono_ns
from server.camera.contracts import StereoFrame, StereoSource
from server.camera.errors import CameraError
from server.camera.rectification import rectification_of, rectifying_maps
from server.camera.sources import device
from server.camera.sources.device import DeviceStereoSource
from server.camera.sources.opening import RectifyingSource, open_source
from server.camera.sources.rtsp import FFMPEG_ENV_VARIABLE, FFMPEG_OPTIONS, RtspStereoSource
from server.camera.sources.settings import (
    DeviceSource,
    EurocSource,
    FolderSource,
    RecordingSource,
    RectifiedSource,
    RtspSource,
)

WAIT_S = 10.0
START_NS = 1_403_636_579_763_555_584
MJPG = {cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"MJPG"))}


class CaptureStandIn:
    """A device: takes what it can do, gives pictures, then nothing."""

    def __init__(self, pictures: list[np.ndarray], fixed: dict[int, float] | None = None) -> None:
        self.properties: dict[int, float] = {}
        self.order: list[int] = []
        self._fixed = fixed or {}
        self._pictures = list(pictures)
        self.more = threading.Event()
        self.released = False

    def isOpened(self) -> bool:
        return self._fixed.get(-1, 1.0) > 0.0

    def set(self, propId: int, value: float, /) -> bool:
        self.order.append(propId)
        self.properties[propId] = value
        return True

    def get(self, propId: int, /) -> float:
        return self._fixed.get(propId, self.properties.get(propId, 0.0))

    def read(self) -> tuple[bool, np.ndarray]:
        if not self._pictures:
            self.more.wait(WAIT_S)
            return False, np.zeros(0)
        return True, self._pictures.pop(0)

    def release(self) -> None:
        self.released = True


def until(condition: object, source: StereoSource) -> str:
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end and not condition(source):  # type: ignore[operator]
        time.sleep(0.002)
    return source.state


def yuyv(grey: np.ndarray) -> np.ndarray:
    return np.stack([grey, np.full_like(grey, 128)], axis=2)


SMALL = DeviceSource(0, width_px=160, height_px=60, rate_hz=30.0, pixel_format="YUYV")


def opened_device(capture: CaptureStandIn, settings: DeviceSource = SMALL) -> DeviceStereoSource:
    return DeviceStereoSource(settings, lambda _index: capture)


@pytest.mark.parametrize("as_jpeg", [False, True])
def test_device_gives_grey_eyes_without_colour(as_jpeg: bool) -> None:
    both = picture(60, 180)
    raw = np.frombuffer(jpeg_of(both), np.uint8).reshape(1, -1) if as_jpeg else yuyv(both)
    capture = CaptureStandIn([raw])
    source = opened_device(capture)
    frame = source.read(WAIT_S)
    capture.more.set()
    source.close()
    assert frame is not None
    assert frame.left.shape == frame.right.shape == (60, 80)
    assert abs(float(frame.left.mean()) - 60.0) < 2.0  # grey levels
    assert abs(float(frame.right.mean()) - 180.0) < 2.0
    assert capture.properties[cv2.CAP_PROP_CONVERT_RGB] == 0
    assert capture.order[0] == cv2.CAP_PROP_FOURCC  # V4L2 lists sizes by format, and rates by size
    assert capture.order.index(cv2.CAP_PROP_FRAME_WIDTH) < capture.order.index(cv2.CAP_PROP_FPS)


def test_device_uses_the_drivers_stamp_where_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever clock it goes by, and however old it is: an old picture is never made a fresh one."""
    slept_ns = 14 * 3600 * 10**9  # the driver's clock stood still meanwhile
    monkeypatch.setattr(device, "suspended_ns", lambda: slept_ns)
    now_ms = mono_ns() * 1e-6
    for given_ms, is_driver in (
        (now_ms - 12.0, True),
        (now_ms - 1500.0, True),
        (1.7e12, True),
        (0.0, False),
        (-1.0, False),
    ):
        capture = CaptureStandIn([yuyv(picture(60, 180))], {cv2.CAP_PROP_POS_MSEC: given_ms})
        source = opened_device(capture)
        frame = source.read(WAIT_S)
        capture.more.set()
        source.close()
        assert frame is not None
        if is_driver:
            assert frame.t_exposure_ns == pytest.approx(given_ms * 1e6 + slept_ns, abs=1e3)
        else:
            assert frame.t_exposure_ns == frame.t_receive_mono_ns


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({cv2.CAP_PROP_FRAME_WIDTH: 134.0}, "width_px = 160, height_px = 60: it gives 134 x 60"),
        ({cv2.CAP_PROP_FPS: 15.0}, "rate_hz = 30: it gives 15"),
        ({cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"MJPG"))}, "pixel_format = 'YUYV': it gives 'MJPG'"),
        ({-1: 0.0}, "cannot be opened"),
    ],
)
def test_device_that_gives_something_else_is_named(given: dict[int, float], told: str) -> None:
    capture = CaptureStandIn([yuyv(picture(60, 180))], given)
    source = opened_device(capture)
    state = until(lambda one: "trying again" in one.state, source)
    assert source.read(0.0) is None
    source.close()
    assert told in state
    assert "/dev/video0" in state
    assert capture.released


def test_device_drops_late_pictures_and_counts_them() -> None:
    capture = CaptureStandIn([yuyv(picture(60, 180, seed)) for seed in range(8)])
    source = opened_device(capture)
    until(lambda one: one.skipped == 7, source)
    frame = source.read(WAIT_S)
    capture.more.set()
    source.close()
    assert frame is not None
    assert (frame.sequence, source.skipped) == (8, 7)


def test_rtsp_takes_the_streams_stamps_and_comes_back() -> None:
    first = CaptureStandIn([cv2.cvtColor(picture(60, 180), cv2.COLOR_GRAY2BGR)], MJPG | {cv2.CAP_PROP_POS_MSEC: 40.0})
    first.more.set()
    second = CaptureStandIn([cv2.cvtColor(picture(90, 120), cv2.COLOR_GRAY2BGR)], MJPG | {cv2.CAP_PROP_POS_MSEC: 20.0})
    captures = [first, second]
    source = RtspStereoSource(RtspSource("rtsp://user:secret@camera/both"), lambda _url: captures.pop(0))
    frames = [source.read(WAIT_S) for _ in range(2)]
    second.more.set()
    source._stop.set()
    source.close()
    one, other = frames
    assert one is not None
    assert other is not None
    assert (one.t_exposure_ns, one.connection_number) == (40_000_000, 1)
    assert (other.t_exposure_ns, other.connection_number) == (20_000_000, 2)
    assert abs(float(other.left.mean()) - 90.0) < 2.0
    assert "secret" not in source.state
    assert first.released


def test_rtsp_without_stamps_goes_by_arrival_as_a_new_clock() -> None:
    pictures = [cv2.cvtColor(picture(60, 180), cv2.COLOR_GRAY2BGR)] * 2
    capture = CaptureStandIn(pictures, MJPG | {cv2.CAP_PROP_POS_MSEC: 0.0})
    source = RtspStereoSource(RtspSource("rtsp://camera/both"), lambda _url: capture)
    until(lambda one: one.skipped == 1, source)
    frame = source.read(WAIT_S)
    capture.more.set()
    source._stop.set()
    source.close()
    assert frame is not None
    assert frame.t_exposure_ns == frame.t_receive_mono_ns
    assert frame.connection_number == 2
    assert "rtsp_transport;tcp" in FFMPEG_OPTIONS


def test_rtsp_with_inter_coded_pictures_needs_consent() -> None:
    """FFmpeg's decoder hides damage in H.264: 38 of 162 looks at a damaged stream ended OK and wrong, by up to 4 mm."""
    both = cv2.cvtColor(picture(60, 180), cv2.COLOR_GRAY2BGR)
    for accepted in (False, True):
        capture = CaptureStandIn([both], {cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"h264"))})
        settings = RtspSource("rtsp://camera/both", accept_inter_coded=accepted)
        source = RtspStereoSource(settings, lambda _url, capture=capture: capture)
        if accepted:
            assert source.read(WAIT_S) is not None
        else:
            state = until(lambda one: "trying again" in one.state, source)
            assert "codec 'H264' hides damaged pictures" in state
            assert "accept_inter_coded = true" in state
            assert capture.released
            assert source.read(0.0) is None
        capture.more.set()
        source._stop.set()
        source.close()


def test_rtsp_url_is_checked_and_keeps_its_password() -> None:
    with pytest.raises(CameraError, match=r"http://user:\*\*\*@camera") as caught:
        open_source(RtspSource("http://user:secret@camera"))
    assert "secret" not in str(caught.value)


def test_rtsp_that_nobody_serves_is_told() -> None:
    source = open_source(RtspSource("rtsp://127.0.0.1:9/none", timeout_s=0.5))
    state = until(lambda one: "trying again" in one.state, source)
    source.close()
    assert "gives no stream" in state
    assert FFMPEG_ENV_VARIABLE not in os.environ  # a video file opened next must not be read by these options


def euroc_data(root: Path, left: list[int], right: list[int]) -> None:
    for eye, numbers in (("cam0", left), ("cam1", right)):
        (root / "mav0" / eye / "data").mkdir(parents=True)
        rows = ["#timestamp [ns],filename"]
        for number in numbers:
            stamp = START_NS + number * 1_000_000
            rows.append(f"{stamp},{stamp}.png")
            grey = 10 * number + (5 if eye == "cam1" else 0)
            cv2.imwrite(str(root / "mav0" / eye / "data" / f"{stamp}.png"), np.full((12, 16), grey, np.uint8))
        (root / "mav0" / eye / "data.csv").write_text("\r\n".join(rows) + "\r\n")


def played(source: StereoSource) -> list[StereoFrame]:
    frames = []
    while not source.ended:
        frame = source.read(1.0)
        if frame is not None:
            frames.append(frame)
    source.close()
    return frames


def test_euroc_pairs_by_stamp(tmp_path: Path) -> None:
    euroc_data(tmp_path, [0, 1, 2, 4], [0, 2, 3, 4])
    source = open_source(EurocSource(str(tmp_path)))
    frames = played(source)
    assert [frame.t_exposure_ns - START_NS for frame in frames] == [0, 2_000_000, 4_000_000]
    assert [(int(frame.left[0, 0]), int(frame.right[0, 0])) for frame in frames] == [(0, 5), (20, 25), (40, 45)]
    assert source.skipped == 2
    assert "end after 3 pairs" in source.state


def test_euroc_plays_by_its_stamps(tmp_path: Path) -> None:
    euroc_data(tmp_path, [0, 25], [0, 25])
    source = open_source(EurocSource(str(tmp_path), speed=0.1))
    frames = played(source)
    apart_ns = frames[1].t_receive_mono_ns - frames[0].t_receive_mono_ns
    assert apart_ns >= 150_000_000  # 25 ms at a tenth of the speed; the first may come late, but never this much


def test_euroc_faults(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match="neither mav0/cam0 nor cam0"):
        open_source(EurocSource(str(tmp_path)))
    euroc_data(tmp_path, [0], [1])
    with pytest.raises(CameraError, match=r"no stamp of cam0 .* is also in cam1"):
        open_source(EurocSource(str(tmp_path)))
    (tmp_path / "mav0" / "cam1" / "data.csv").write_text("soon,one.png\n")
    with pytest.raises(CameraError, match="line 1 is not"):
        open_source(EurocSource(str(tmp_path)))


def test_a_damaged_picture_is_left_out(tmp_path: Path) -> None:
    euroc_data(tmp_path, [0, 1, 2], [0, 1, 2])
    (tmp_path / "mav0" / "cam0" / "data" / f"{START_NS + 1_000_000}.png").write_bytes(b"no picture")
    source = open_source(EurocSource(str(tmp_path)))
    assert [int(frame.left[0, 0]) for frame in played(source)] == [0, 20]
    assert source.skipped == 1
    folder = tmp_path / "mav0" / "cam0" / "data"
    again = open_source(FolderSource(f"{folder}/*.png", f"{folder}/*.png", rate_hz=1e4))
    assert [int(frame.left[0, 0]) for frame in played(again)] == [0, 20]


def stamp_of(t_ns: int) -> Timestamp:
    return Timestamp(seconds=t_ns // 1_000_000_000, nanos=t_ns % 1_000_000_000)


def recording(path: Path, messages: list[tuple[str, Message]], finish: bool = True) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1)
        writer.start()
        channels: dict[str, int] = {}
        for topic, message in messages:
            if topic not in channels:
                descriptor = build_file_descriptor_set(type(message)).SerializeToString()
                schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", descriptor)
                channels[topic] = writer.register_channel(topic, "protobuf", schema)
            t_ns = message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos  # type: ignore[attr-defined]
            writer.add_message(channels[topic], t_ns, message.SerializeToString(), t_ns)
        if finish:
            writer.finish()


def compressed(t_ns: int, grey: int) -> Message:
    return CompressedImage(timestamp=stamp_of(t_ns), data=jpeg_of(np.full((12, 16), grey, np.uint8)), format="jpeg")


def raw(t_ns: int, pixels: np.ndarray, encoding: str, pad: int = 0) -> Message:
    rows = pixels.reshape(pixels.shape[0], -1)
    rows = np.hstack([rows, np.zeros((len(rows), pad), np.uint8)])
    height, width = pixels.shape[:2]
    return RawImage(
        timestamp=stamp_of(t_ns), width=width, height=height, encoding=encoding, step=rows.shape[1], data=rows.tobytes()
    )


def test_recording_with_a_topic_for_each_eye(tmp_path: Path) -> None:
    path = tmp_path / "both.mcap"
    at = [START_NS + number * 1_000_000_000 // 500 for number in range(4)]
    recording(
        path,
        [
            ("/camera/left", compressed(at[0], 40)),
            ("/camera/right", compressed(at[0] + 300_000, 80)),
            ("/camera/left", compressed(at[1], 41)),  # its partner was lost
            ("/camera/right", compressed(at[2] + 1_000_000, 82)),  # right before left
            ("/camera/left", compressed(at[2] + 1_000_500, 42)),
        ],
    )
    source = open_source(RecordingSource(str(path)))
    frames = played(source)
    assert [(int(frame.left[0, 0]), int(frame.right[0, 0])) for frame in frames] == [(40, 80), (42, 82)]
    assert frames[0].t_exposure_ns == at[0]
    assert source.skipped == 1


@pytest.mark.parametrize("encoding", ["mono8", "bgr8", "rgba8", "yuyv", "uyvy"])
def test_recording_side_by_side_in_every_encoding(tmp_path: Path, encoding: str) -> None:
    both = picture(60, 180)
    pixels = {
        "mono8": both,
        "bgr8": cv2.cvtColor(both, cv2.COLOR_GRAY2BGR),
        "rgba8": cv2.cvtColor(both, cv2.COLOR_GRAY2RGBA),
        "yuyv": yuyv(both),
        "uyvy": yuyv(both)[..., ::-1],
    }[encoding]
    path = tmp_path / "pair.mcap"
    recording(path, [("/pair", raw(START_NS, np.ascontiguousarray(pixels), encoding, pad=6))])
    (frame,) = played(open_source(RecordingSource(str(path), pair_topic="/pair")))
    np.testing.assert_array_equal(np.hstack([frame.left, frame.right]), both)


def test_cut_recording_plays_what_is_there(tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    eyes = [
        (topic, compressed(START_NS + k * 1_000_000, 40))
        for k in range(3)
        for topic in ("/camera/left", "/camera/right")
    ]
    recording(path, eyes, finish=False)
    path.write_bytes(path.read_bytes()[:-40])
    assert len(played(open_source(RecordingSource(str(path))))) == 2


def test_recording_faults(tmp_path: Path) -> None:
    path = tmp_path / "ours.mcap"
    recording(path, [("/camera/left", compressed(START_NS, 40))])
    with pytest.raises(
        CameraError, match=r"no images on /camera/right; it has /camera/left .* left eye's preview only"
    ):
        open_source(RecordingSource(str(path)))
    with pytest.raises(CameraError, match=r"no images on /both; .* pair_topic"):
        open_source(RecordingSource(str(path), pair_topic="/both"))
    (tmp_path / "text.mcap").write_text("nothing")
    with pytest.raises(CameraError, match="not an MCAP file"):
        open_source(RecordingSource(str(tmp_path / "text.mcap")))
    with pytest.raises(CameraError, match="No such file"):
        open_source(RecordingSource(str(tmp_path / "none.mcap")))
    recording(tmp_path / "odd.mcap", [("/pair", raw(START_NS, np.zeros((4, 6), np.uint8), "bayer"))])
    source = open_source(RecordingSource(str(tmp_path / "odd.mcap"), pair_topic="/pair"))
    assert source.read(1.0) is None
    assert "encoding 'bayer'; known are mono8" in source.state


class OnePair:
    """A source with one pair, then none."""

    def __init__(self, left: np.ndarray, right: np.ndarray) -> None:
        self._frame: StereoFrame | None = StereoFrame(left, right, 7, 8, 9, 2)
        self.skipped, self.state, self.ended, self.closed = 3, "source's own", False, False

    def read(self, timeout_s: float) -> StereoFrame | None:
        frame, self._frame = self._frame, None
        return frame

    def close(self) -> None:
        self.closed = True


def test_rectifying_source_gives_rectified_pairs_with_the_same_stamps() -> None:
    rig = brown_rig()
    rng = np.random.default_rng(5)
    left, right = (cv2.GaussianBlur(rng.integers(0, 256, (720, 1280)).astype(np.uint8), (0, 0), 3) for _ in range(2))
    inner = OnePair(left, right)
    source = RectifyingSource(inner, RectifiedSource(DeviceSource(0, 2560, 720, 60.0, "YUYV"), rig, 60.0))
    frame = source.read(0.0)
    assert frame is not None
    assert source.read(0.0) is None
    assert (frame.t_exposure_ns, frame.t_receive_mono_ns, frame.sequence, frame.connection_number) == (7, 8, 9, 2)
    assert (source.skipped, source.state, source.ended) == (3, "source's own", False)
    maps = rectifying_maps(rig, rectification_of(rig, 60.0))
    for image, (x, y), got in ((left, maps[0], frame.left), (right, maps[1], frame.right)):
        np.testing.assert_array_equal(got, cv2.remap(image, x, y, cv2.INTER_LINEAR))
    source.close()
    assert inner.closed


def test_rectifying_source_refuses_pictures_of_another_size() -> None:
    inner = OnePair(np.zeros((376, 672), np.uint8), np.zeros((376, 672), np.uint8))
    source = RectifyingSource(inner, RectifiedSource(DeviceSource(0, 2560, 720, 60.0, "YUYV"), brown_rig(), 60.0))
    assert source.read(0.0) is None
    assert f"calibration file is for {SIZE_PX[0]} x {SIZE_PX[1]}" in source.state
    source.close()
