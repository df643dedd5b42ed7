"""Every kind of source gives pairs, the newest first, and comes back after a loss."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_stand_in import CameraStandIn, jpeg_of, part_of, picture

from server.camera.errors import CameraError, StreamError
from server.camera.sources.folder import FolderStereoSource
from server.camera.sources.http import HttpStereoSource
from server.camera.sources.live import STALL_MIN_NS, NewestOnlyBox
from server.camera.sources.opening import open_source
from server.camera.sources.settings import FileSource, FolderSource, HttpSource
from server.camera.sources.side_by_side import decode_side_by_side, split_side_by_side

WAIT_S = 10.0


def test_http_pairs_carry_stamps_and_halves() -> None:
    with CameraStandIn() as camera:
        source = HttpStereoSource(HttpSource(camera.url))
        camera.send(part_of(jpeg_of(picture(50, 200)), 123_456, 3))
        frame = source.read(WAIT_S)
        source.close()
    assert frame is not None
    assert (frame.t_exposure_ns, frame.sequence, frame.connection_number) == (123_456, 3, 1)
    assert frame.left.shape == frame.right.shape == (60, 80)
    assert abs(float(frame.left.mean()) - 50.0) < 2.0  # grey levels
    assert abs(float(frame.right.mean()) - 200.0) < 2.0


def test_http_gives_the_newest_and_counts_the_rest() -> None:
    with CameraStandIn() as camera:
        source = HttpStereoSource(HttpSource(camera.url))
        body = jpeg_of(picture(90, 90))
        camera.send(b"".join(part_of(body, number, number) for number in range(1, 21)))
        seen: list[int] = []
        while not seen or seen[-1] < 20:
            frame = source.read(WAIT_S)
            assert frame is not None
            seen.append(frame.sequence)
        source.close()
    assert seen == sorted(seen)
    assert source.skipped == 20 - len(seen)


def test_http_without_stamps_uses_the_time_of_arrival() -> None:
    with CameraStandIn() as camera:
        source = HttpStereoSource(HttpSource(camera.url))
        camera.send(part_of(jpeg_of(picture(90, 90)), None, None))
        frame = source.read(WAIT_S)
        source.close()
    assert frame is not None
    assert frame.t_exposure_ns == frame.t_receive_mono_ns
    assert frame.sequence == 1


def test_http_comes_back_after_a_lost_stream_and_after_garbage() -> None:
    with CameraStandIn() as camera:
        source = HttpStereoSource(HttpSource(camera.url))
        assert "connecting" in source.state
        body = jpeg_of(picture(90, 90))
        camera.send(part_of(body, 1, 1))
        assert source.read(WAIT_S) is not None
        assert source.state == ""
        camera.hang_up()
        camera.send(part_of(body, 2, 2))  # waits for the new connection
        frame = source.read(WAIT_S)
        assert frame is not None
        assert (frame.sequence, frame.connection_number) == (2, 2)
        camera._connected.clear()
        assert camera._client is not None
        camera._client.sendall(b"garbage" * 2000)
        camera.send(part_of(body, 3, 3))
        frame = source.read(WAIT_S)
        assert frame is not None
        assert (frame.sequence, frame.connection_number) == (3, 3)
        source.close()


def test_http_passes_over_a_broken_picture() -> None:
    with CameraStandIn() as camera:
        source = HttpStereoSource(HttpSource(camera.url))
        camera.send(part_of(b"not a jpeg", 1, 1))
        assert source.read(WAIT_S) is None
        assert "not a JPEG" in source.state
        camera.send(part_of(jpeg_of(picture(90, 90)), 2, 2))
        frame = source.read(WAIT_S)
        assert frame is not None
        assert frame.sequence == 2
        source.close()


@pytest.mark.parametrize("url", ["rtsp://camera/stream", "http://camera:80801/stream", "http://camera:x/stream"])
def test_http_url_is_checked(url: str) -> None:
    with pytest.raises(CameraError, match="not http"):
        HttpStereoSource(HttpSource(url))


def test_newest_keeps_one_and_counts() -> None:
    box: NewestOnlyBox[int] = NewestOnlyBox()
    assert box.take_newest(0.0) is None
    for number in range(5):
        box.put(number)
    assert box.take_newest(0.0) == 4
    assert box.take_newest(0.0) is None
    assert box.skipped == 4


def test_odd_width_and_damaged_jpeg_are_refused() -> None:
    with pytest.raises(StreamError, match="odd"):
        split_side_by_side(np.zeros((10, 11), np.uint8))
    with pytest.raises(StreamError, match="not a JPEG"):
        decode_side_by_side(b"\xff\xd8 no")


def test_folder_in_name_order_with_stamps(tmp_path: Path) -> None:
    for eye in ("left", "right"):
        (tmp_path / eye).mkdir()
        for number in range(3):
            grey = 40 * number + (20 if eye == "right" else 0)
            name = f"{1_403_636_579_763_555_584 + number * 50_000_000}.png"
            cv2.imwrite(str(tmp_path / eye / name), np.full((10, 12), grey, np.uint8))
    source = open_source(FolderSource(f"{tmp_path}/left/*.png", f"{tmp_path}/right/*.png", rate_hz=1e4))
    frames = [source.read(1.0) for _ in range(3)]
    assert source.ended
    assert source.read(0.0) is None
    assert "end after 3" in source.state
    for number, frame in enumerate(frames):
        assert frame is not None
        assert frame.t_exposure_ns == 1_403_636_579_763_555_584 + number * 50_000_000
        assert (frame.left[0, 0], frame.right[0, 0]) == (40 * number, 40 * number + 20)


def test_folder_with_unequal_eyes_is_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((4, 4), np.uint8))
    with pytest.raises(CameraError, match="1 left files"):
        open_source(FolderSource(f"{tmp_path}/*.png", f"{tmp_path}/*.jpg", rate_hz=10.0))


def write_eyes(folder: Path, left_names: list[str], right_names: list[str]) -> FolderSource:
    """Pictures of which each has the grey of its number."""
    for eye, names in (("left", left_names), ("right", right_names)):
        (folder / eye).mkdir()
        for name in names:
            grey = int("".join(filter(str.isdigit, name))) % 200
            cv2.imwrite(str(folder / eye / name), np.full((10, 12), grey, np.uint8))
    return FolderSource(f"{folder}/left/*.png", f"{folder}/right/*.png", rate_hz=1e4)


def played(settings: FolderSource) -> list[tuple[int, int, int]]:
    """Grey of both eyes and stamp of every pair."""
    source = open_source(settings)
    found = []
    while not source.ended:
        frame = source.read(1.0)
        assert frame is not None
        found.append((int(frame.left[0, 0]), int(frame.right[0, 0]), frame.t_exposure_ns))
    return found


def test_folder_in_the_order_of_its_numbers_whatever_their_length(tmp_path: Path) -> None:
    names = [f"{number}.png" for number in range(51)]
    assert [(left, right) for left, right, _ in played(write_eyes(tmp_path, names, names))] == [
        (n, n) for n in range(51)
    ]


def test_folder_pairs_by_what_the_wildcards_stand_for(tmp_path: Path) -> None:
    for eye, shift in (("l", 0), ("r", 100)):
        for number in range(12):
            cv2.imwrite(str(tmp_path / f"im{number}_{eye}.png"), np.full((10, 12), number + shift, np.uint8))
    pairs = played(FolderSource(f"{tmp_path}/im*_l.png", f"{tmp_path}/im*_r.png", rate_hz=1e4))
    assert [(left, right) for left, right, _ in pairs] == [(number, number + 100) for number in range(12)]


@pytest.mark.parametrize(("lost_left", "lost_right", "named"), [(4, 7, "right/4.png"), (9, 3, "left/3.png")])
def test_folder_with_a_file_missing_in_each_eye_names_the_first_odd_one(
    tmp_path: Path, lost_left: int, lost_right: int, named: str
) -> None:
    names = [[f"{number}.png" for number in range(12) if number != lost] for lost in (lost_left, lost_right)]
    with pytest.raises(CameraError, match=f"picture '[^']*{named}' has no .* the first of 2"):
        open_source(write_eyes(tmp_path, *names))


@pytest.mark.parametrize(
    ("names", "steps_ns"),
    [
        (["1403636579763555584", "1403636579813555584"], 50_000_000),
        (["1403636579763555", "1403636579813555"], 50_000_000),
        (["1403636579763", "1403636579813"], 50_000_000),
        (["1403636579.763555", "1403636579.813555"], 50_000_000),
        (["0000000000", "0000000001"], 100_000),  # numbers, at 10 kHz
        (["frame7", "frame12"], 100_000),
    ],
)
def test_folder_names_are_times_where_a_unit_makes_them_one(tmp_path: Path, names: list[str], steps_ns: int) -> None:
    files = [f"{name}.png" for name in names]
    first, second = (t_ns for _, _, t_ns in played(write_eyes(tmp_path, files, files)))
    assert second - first == steps_ns


def test_folder_names_whose_unit_is_unknown_are_refused_until_it_is_set(tmp_path: Path) -> None:
    settings = write_eyes(tmp_path, ["50000000000000000.png"], ["50000000000000000.png"])
    with pytest.raises(CameraError, match="stamp_unit"):
        open_source(settings)
    assert played(replace(settings, stamp_unit="ns"))[0][2] == 50_000_000_000_000_000
    assert played(replace(settings, stamp_unit="us"))[0][2] == 50_000_000_000_000_000_000
    assert played(replace(settings, stamp_unit="number"))[0][2] == 0


def test_video_file_gives_every_frame(tmp_path: Path) -> None:
    path = str(tmp_path / "clip.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 100.0, (160, 60))
    for number in range(4):
        frame = np.hstack([np.full((60, 80, 3), 30 + 40 * number, np.uint8), np.full((60, 80, 3), 10, np.uint8)])
        writer.write(frame)
    writer.release()
    source = open_source(FileSource(path))
    frames = [source.read(1.0) for _ in range(4)]
    assert source.read(1.0) is None
    assert source.ended
    source.close()
    for number, frame in enumerate(frames):
        assert frame is not None
        assert frame.t_exposure_ns == pytest.approx(number * 10_000_000, abs=1)
        assert float(frame.left.mean()) == pytest.approx(30 + 40 * number, abs=3.0)  # grey levels after MJPG
        assert float(frame.right.mean()) == pytest.approx(10, abs=3.0)


def test_inter_coded_video_file_needs_consent(tmp_path: Path) -> None:
    path = str(tmp_path / "clip.mp4")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (160, 64))
    writer.write(np.zeros((64, 160, 3), np.uint8))
    writer.release()
    with pytest.raises(CameraError, match=r"codec 'FMP4' hides damaged pictures.*accept_inter_coded = true"):
        open_source(FileSource(path))
    source = open_source(FileSource(path, accept_inter_coded=True))
    assert source.read(1.0) is not None
    source.close()


def test_missing_video_file_is_refused() -> None:
    with pytest.raises(CameraError, match="cannot be opened"):
        open_source(FileSource("no/such/file.avi"))


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (["1403636579.25.png", "1403636579.3.png", "1403636579.5.png"], [0, 1, 2]),  # as Python's str(float) ends
        (["1403636579.3.png", "1403636579.25.png"], [1, 0]),
        (["0.png", "1.png", "-1.png", "-2.png"], [3, 2, 0, 1]),
        (["-10.png", "-2.png"], [1, 0]),  # a separator
    ],
)
def test_folder_is_played_in_the_order_of_its_times_and_signs(
    tmp_path: Path, names: list[str], order: list[int]
) -> None:
    source = FolderStereoSource(write_eyes(tmp_path, names, names))
    assert [Path(left).name for left, _ in source._files] == [names[k] for k in order]
    assert source._stamps_ns == sorted(source._stamps_ns)


@pytest.mark.parametrize("stamp_ns", [None, 123_456])
def test_what_waited_while_this_process_was_held_up_is_not_stamped_as_of_now(stamp_ns: int | None) -> None:
    with CameraStandIn() as camera:
        source = HttpStereoSource(HttpSource(camera.url))
        camera.send(part_of(jpeg_of(picture(50, 200)), stamp_ns, 1))
        assert source.read(WAIT_S) is not None
        source._heartbeat._last_ns -= 10 * STALL_MIN_NS  # no thread of it ran
        camera.send(part_of(jpeg_of(picture(50, 200)), stamp_ns, 2))
        frame = source.read(2.0 if stamp_ns is None else WAIT_S)
        connections = source._connection
        source.close()
    if stamp_ns is None:
        assert frame is None
        assert connections > 1  # asked again: what the system had kept is gone
    else:
        assert frame is not None
        assert frame.t_exposure_ns == stamp_ns
