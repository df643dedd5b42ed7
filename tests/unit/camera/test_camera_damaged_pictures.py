"""Damaged JPEG data are refused, whole ones of any encoder are not, and a picture shifted by blocks is not used."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from server.camera.errors import CameraError, StreamError
from server.camera.health.findings import FaultCode
from server.camera.health.image_health import MARKER_JUMP_MIN_PX, JumpMonitor
from server.camera.sources.folder import read_grey
from server.camera.sources.jpeg_scan import damage_of
from server.camera.sources.side_by_side import decode_grey
from server.vision.contracts import MarkerView
from sim_plc.camera.faults import with_flipped_bits

BLOCK_PX = 8
RST, SAMPLING = cv2.IMWRITE_JPEG_RST_INTERVAL, cv2.IMWRITE_JPEG_SAMPLING_FACTOR


def scene(seed: int = 1, shape: tuple[int, int] = (160, 320)) -> np.ndarray:
    """Soft spots on a plain wall: most blocks take a few bits only."""
    rng = np.random.default_rng(seed)
    spots = cv2.GaussianBlur((rng.random(shape) > 0.995).astype(np.float32), (0, 0), 4.0)
    return np.clip(120.0 + 4000.0 * spots, 0, 255).astype(np.uint8)


def encoded(picture: np.ndarray, *options: int) -> np.ndarray:
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 75, *options])[1].reshape(-1)


def is_shifted(seen: np.ndarray, whole: np.ndarray) -> bool:
    """Whether the last rows of blocks fit the whole picture better when moved by one block."""
    rows, before = seen[-4 * BLOCK_PX :].astype(float), whole[-4 * BLOCK_PX :].astype(float)
    rows, before = rows - rows.mean(), before - before.mean()
    moved = [np.abs(rows - np.roll(before, shift, axis=1)).mean() for shift in (-BLOCK_PX, 0, BLOCK_PX)]
    return moved[1] > min(moved)


@pytest.mark.parametrize("options", [(), (RST, 40)])
def test_a_flipped_bit_that_shifts_the_picture_by_blocks_is_found(options: tuple[int, ...]) -> None:
    jpeg, rng = encoded(scene(), *options).tobytes(), np.random.default_rng(2)
    whole, n_shifted = decode_grey(jpeg), 0
    for _ in range(400):
        damaged = np.frombuffer(with_flipped_bits(jpeg, 1, rng), np.uint8)
        seen = cv2.imdecode(damaged, cv2.IMREAD_GRAYSCALE)
        if not options and is_shifted(np.asarray(seen, np.uint8), whole):
            n_shifted += 1
            assert damage_of(damaged)
    assert options or n_shifted > 20  # of 400; with restart markers no bit shifts the last rows


def test_lost_stretches_and_early_ends_are_found() -> None:
    jpeg = encoded(scene())
    first = jpeg.tobytes().index(b"\xff\xda") + 10
    for place in range(first, len(jpeg) - 103, 7):
        assert damage_of(np.delete(jpeg, slice(place, place + 100)))
        assert damage_of(jpeg[:place]).startswith("its data end early at block ")


@pytest.mark.parametrize("shape", [(160, 320), (101, 205), (9, 17)])
@pytest.mark.parametrize(
    "options",
    [(), (RST, 7), (cv2.IMWRITE_JPEG_OPTIMIZE, 1), (SAMPLING, 0x411111), (SAMPLING, 0x221111), (SAMPLING, 0x111111)],
)
def test_whole_pictures_of_any_encoder_are_taken(shape: tuple[int, int], options: tuple[int, ...]) -> None:
    for quality in (30, 75, 98):
        for picture in (scene(3, shape), cv2.merge([scene(seed, shape) for seed in (3, 4, 5)])):
            assert damage_of(encoded(picture, *options, cv2.IMWRITE_JPEG_QUALITY, quality)) == ""


def test_what_usb_cameras_leave_out_or_add_is_no_damage() -> None:
    jpeg = encoded(cv2.merge([scene()] * 3))
    data = jpeg.tobytes()
    assert damage_of(np.concatenate([jpeg, np.zeros(5000, np.uint8)])) == ""  # the rest of the driver's buffer
    assert damage_of(jpeg[:-2]) == ""  # without an end marker
    bare = data
    while (at := bare.find(b"\xff\xc4")) > 0:  # without tables: those of the standard are meant
        bare = bare[:at] + bare[at + 2 + int.from_bytes(bare[at + 2 : at + 4], "big") :]
    assert len(bare) < len(data) - 400
    assert damage_of(np.frombuffer(bare, np.uint8)) == ""
    assert np.array_equal(decode_grey(bare), decode_grey(data))


def test_restart_markers_out_of_turn_and_other_kinds_of_jpeg_are_refused() -> None:
    jpeg = encoded(scene(), RST, 40).tobytes()
    assert "out of turn" in damage_of(np.frombuffer(jpeg.replace(b"\xff\xd1", b"\xff\xd2", 1), np.uint8))
    assert "baseline" in damage_of(encoded(scene(), cv2.IMWRITE_JPEG_PROGRESSIVE, 1))
    assert damage_of(np.frombuffer(jpeg[:30], np.uint8)) == "its header is cut or contradicts itself"


def test_any_bytes_give_an_answer() -> None:
    jpeg, rng = encoded(scene(), RST, 40), np.random.default_rng(4)
    for _ in range(300):
        damaged = jpeg[: int(rng.integers(2, len(jpeg)))].copy()
        damaged[rng.integers(2, len(damaged) + 1, 5) - 1] = rng.integers(0, 256, 5)
        assert isinstance(damage_of(damaged), str)


def test_a_damaged_picture_becomes_no_pair(tmp_path) -> None:
    jpeg = encoded(scene())
    jpeg = np.delete(jpeg, len(jpeg) // 2)
    with pytest.raises(StreamError, match=r"is damaged, .* check cable"):
        decode_grey(jpeg)
    path = tmp_path / "0.jpg"
    path.write_bytes(jpeg.tobytes())
    with pytest.raises(CameraError, match=r"0\.jpg.*is damaged"):
        read_grey(str(path))


# --- what a decoder cannot know -------------------------------------------------------------------------------------

SQUARE = np.array([[60.0, 60.0], [100.0, 61.0], [99.0, 101.0], [59.0, 100.0]])
PERIOD_NS = 33_000_000


def findings(places_px: list[float], period_ns: int = PERIOD_NS, corners: np.ndarray = SQUARE) -> list[bool]:
    """Whether each pair of a marker at these columns is found to have jumped."""
    monitor, found = JumpMonitor(), []
    for number, place in enumerate(places_px):
        seen = corners + np.array([place, 0.0])
        view = MarkerView(10, seen, seen - [48.0, 0.0], 0.05, True, "")
        pair: Any = SimpleNamespace(
            observation=SimpleNamespace(marker_views=(view,)),
            frame=SimpleNamespace(t_exposure_ns=(number + 1) * period_ns),
            is_first=number == 0,
        )
        found_now = monitor.check(pair)
        assert all(one.code is FaultCode.JUMPED and one.forbids_look and not one.forbids_odometry for one in found_now)
        found.append(bool(found_now))
    return found


@pytest.mark.parametrize("blocks", [-2, -1, 1, 2, 3])
@pytest.mark.parametrize("speed_px", [0.0, 5.0, -7.0])
def test_both_eyes_shifted_by_whole_blocks_are_found_at_rest_and_in_motion(blocks: int, speed_px: float) -> None:
    places = [speed_px * number for number in range(12)]
    places[6] += BLOCK_PX * blocks
    found = findings(places)
    assert not any(found[:6])
    assert found[6]
    assert not any(found[9:])


@pytest.mark.parametrize("period_ms", [150, 200, 300])
def test_a_slow_camera_shows_shifts_beyond_what_a_machine_can_do_in_its_interval(period_ms: int) -> None:
    least_px = MARKER_JUMP_MIN_PX * (period_ms / 120) ** 2
    for blocks in (1, 2):  # more would meet another corner of the marker
        found = findings([0.0] * 4 + [BLOCK_PX * blocks] + [0.0] * 4, period_ns=period_ms * 1_000_000)
        assert not any(found[:4])
        assert bool(found[4]) == (BLOCK_PX * blocks > least_px)


def test_a_board_of_many_corners_is_followed_too() -> None:
    board = np.stack(np.meshgrid(np.arange(6) * 30.0, np.arange(4) * 30.0), axis=2).reshape(-1, 2)
    assert findings([0.0] * 4 + [BLOCK_PX] + [0.0] * 4, corners=board)[4]


def test_a_machine_that_starts_and_stops_does_not_jump() -> None:
    speed_px = np.concatenate([np.zeros(5), np.linspace(0.0, 7.0, 10), np.full(10, 7.0), np.linspace(7.0, 0.0, 6)])
    assert not any(findings(list(np.cumsum(speed_px))))
    assert not any(findings(list(np.cumsum(6.0 * speed_px)), period_ns=200_000_000))
    assert MARKER_JUMP_MIN_PX == BLOCK_PX / 2
