"""Health of images, the camera's clock, and the tool's mask."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from camera_stand_in import picture

from server.camera.contracts import StereoFrame
from server.camera.health.blur import sharpness
from server.camera.health.findings import FaultCode, Finding
from server.camera.health.image_health import ImageHealth
from server.camera.health.stamps import STARTING_PAIRS
from server.camera.pipeline import CameraClock
from server.camera.sources.side_by_side import split_side_by_side
from server.targets.tool_mask import MASK_EXTENSION_PX, ToolMask, blown_up, plate_and_shaft
from server.vision.contracts import MarkerView

MS = 1_000_000


def frame(number: int, left: int = 90, right: int = 100, seed: int | None = None) -> StereoFrame:
    eyes = split_side_by_side(picture(left, right, number if seed is None else seed))
    return StereoFrame(*eyes, t_exposure_ns=number * 66 * MS, t_receive_mono_ns=number * 66 * MS, sequence=number)


def test_healthy_images_give_no_warning() -> None:
    health = ImageHealth()
    assert [health.check(frame(number)) for number in range(5)] == [()] * 5


@pytest.mark.parametrize(
    ("sick", "text"),
    [
        (frame(2, 0, 0), "both eyes are black"),
        (frame(2, 90, 0), "right eye is black"),
        (frame(2, 0, 90), "left eye is black"),
        (frame(2, 255, 100), "saturated"),
        (frame(2, seed=1), "left image repeats"),
        (replace(frame(2), t_exposure_ns=66 * MS), "does not advance"),
        (replace(frame(2), t_exposure_ns=0), "backwards by 66.0 ms"),
    ],
)
def test_sick_images_are_named(sick: StereoFrame, text: str) -> None:
    health = ImageHealth()
    health.check(frame(1))
    assert text in "; ".join(health.check(sick))


@pytest.mark.parametrize("wide", [3, 7])
def test_a_worker_that_catches_up_is_no_clock_that_jumps(wide: int) -> None:
    health = ImageHealth()
    numbers = [*range(0, 20 * wide, wide), *range(20 * wide, 20 * wide + 20)]
    assert [health.check(frame(number)) for number in numbers] == [()] * 40


def test_a_clock_that_jumps_is_found_while_pairs_are_passed_over() -> None:
    health = ImageHealth()
    for number in range(0, 60, 3):
        health.check(frame(number))
    back = replace(frame(60), t_exposure_ns=58 * 66 * MS)
    assert "stamps jumped: a step of 66.0 ms where 198.0 ms are usual" in "; ".join(health.check(back))


@pytest.mark.parametrize("slow", [3, 6])
def test_a_camera_that_is_faster_than_it_was_is_used_again(slow: int) -> None:
    """A simulated camera on a busy computer: its count goes on by one however long a picture took."""
    health = ImageHealth()
    stamps = [*range(0, 130 * slow, slow), *range(130 * slow, 130 * slow + 30)]
    frames = [replace(frame(stamp), sequence=number) for number, stamp in enumerate(stamps)]
    found = [health.check(one) for one in frames]
    assert any(found)  # said, learnt anew, and over as soon as ten good pairs have come
    assert found[-9:] == [()] * 9


def codes(findings: tuple[Finding, ...]) -> set[FaultCode]:
    return {finding.code for finding in findings}


def test_a_new_connection_may_have_a_new_clock_and_its_first_pictures_are_for_no_look() -> None:
    health = ImageHealth()
    health.check(frame(9))
    found = [health.inspect(replace(frame(number), connection_number=2)) for number in range(1, 20)]
    assert [codes(one) for one in found] == [{FaultCode.STARTING}] * STARTING_PAIRS + [set()] * (19 - STARTING_PAIRS)
    assert found[0][0].forbids_look
    assert not found[0][0].forbids_odometry  # its own stamps serve it


@pytest.mark.parametrize("stamp", ["the old one", "a new one"])
def test_a_dead_camera_that_gives_its_last_picture_to_every_caller_is_frozen(stamp: str) -> None:
    """A gateway whose grabber hangs: it answers each connection with what it has, and closes."""
    health = ImageHealth()
    health.check(replace(frame(1), connection_number=1))
    for connection in range(2, 9):
        t_ns = connection * 700 * MS
        again = replace(frame(1), connection_number=connection, t_receive_mono_ns=t_ns)
        again = again if stamp == "the old one" else replace(again, t_exposure_ns=t_ns)
        found = codes(health.inspect(again))
        assert {FaultCode.FROZEN, FaultCode.STARTING} <= found
        assert (FaultCode.STAMP_STANDS in found) == (stamp == "the old one")


def test_blur_lowers_sharpness() -> None:
    rng = np.random.default_rng(1)
    sharp = rng.integers(0, 255, (80, 80)).astype(np.uint8)
    blurred = (sharp[:-1, :-1] // 4 + sharp[1:, :-1] // 4 + sharp[:-1, 1:] // 4 + sharp[1:, 1:] // 4).astype(np.uint8)
    assert sharpness(blurred) < 0.6 * sharpness(sharp)


def test_clock_keeps_the_smallest_latency() -> None:
    rng = np.random.default_rng(2)
    clock = CameraClock()
    offset_ns, smallest_ns = 5_000_000_000_000, 30 * MS
    errors = []
    for number in range(900):
        t_camera = number * 66 * MS
        latency = smallest_ns + int(rng.exponential(8.0) * MS)
        mapped = clock.to_pc_clock(t_camera, t_camera + offset_ns + latency)
        errors.append(mapped - (t_camera + offset_ns + smallest_ns))
    assert min(errors[50:]) >= 0
    assert max(errors[50:]) < 1.0 * MS
    slow = [clock.to_pc_clock(number * 66 * MS, number * 66 * MS + offset_ns + 50 * MS) for number in range(900, 1200)]
    assert slow[-1] < 1199 * 66 * MS + offset_ns + smallest_ns + 3 * MS  # a slow line is no clock that was set


def test_clock_starts_afresh_with_a_new_connection_and_with_a_clock_set_forward() -> None:
    clock = CameraClock()
    clock.to_pc_clock(0, 100 * MS)
    assert clock.to_pc_clock(10_000 * MS, 300 * MS) == 300 * MS
    assert clock.to_pc_clock(10_001 * MS, 900 * MS, connection=2) == 900 * MS


def test_mask_covers_the_tool_and_remembers_it() -> None:
    corners = np.array([[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]])
    np.testing.assert_allclose(blown_up(corners, 2.0), [[5, 5], [25, 5], [25, 25], [5, 25]], atol=1e-12)
    shaft = plate_and_shaft(corners, 2.0)
    np.testing.assert_allclose(shaft[:2], [[5, 5], [25, 5]], atol=1e-12)
    np.testing.assert_allclose(shaft[2:], [[25, 25 + MASK_EXTENSION_PX], [5, 25 + MASK_EXTENSION_PX]], atol=1e-9)
    mask = ToolMask([10], 2.0)
    mask.update([MarkerView(10, corners, None, 0.1, True, ""), MarkerView(1, corners, corners, 0.1, True, "")])
    assert len(mask.left_polygons) == 1
    assert mask.right_polygons == ()
    mask.update([MarkerView(10, None, corners + 3.0, 0.1, True, "")])
    np.testing.assert_allclose(mask.left_polygons[0], plate_and_shaft(corners, 2.0), atol=1e-12)
    np.testing.assert_allclose(mask.right_polygons[0], plate_and_shaft(corners + 3.0, 2.0), atol=1e-12)


def test_mask_covers_a_board_on_the_tool_however_much_of_it_is_seen() -> None:
    """Unmasked, what moves with the camera told the odometry that nothing moves."""
    x, y = np.meshgrid(np.arange(5.0), np.arange(3.0))
    turn = np.deg2rad(20.0)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = 300.0 + 20.0 * np.column_stack([x.ravel(), y.ravel()]) @ R.T
    printed = 300.0 + 20.0 * (np.array([[-1.0, -1.0], [5.0, -1.0], [5.0, 3.0], [-1.0, 3.0]])) @ R.T
    seen = corners.copy()
    seen[[3, 7]] = np.nan
    mask = ToolMask({7: 4.0 / 2.0}, 1.1)
    mask.update([MarkerView(7, seen, None, 0.1, True, "")])
    (polygon,) = mask.left_polygons
    for point in printed:
        assert cv2.pointPolygonTest(polygon.astype(np.float32), tuple(map(float, point)), False) >= 0.0
    assert polygon[:, 1].max() > 2000.0, "the holder comes from below"
    few = np.full_like(corners, np.nan)
    few[:3] = corners[:3]
    mask.update([MarkerView(7, few, None, 0.1, True, "")])
    np.testing.assert_array_equal(mask.left_polygons[0], polygon)
