"""Every fault of pictures and stamps is found and named; good pairs are not."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import cycle, islice

import cv2
import numpy as np
import pytest
from health_pictures import CAMERA, HEIGHT, MS, PERIOD_MS, WIDTH, Camera, moved_stamp, sent, walk

from server.camera.contracts import StereoFrame
from server.camera.health.findings import FaultCode, Finding
from server.camera.health.image_health import RECOVERY_PAIRS, ImageHealth
from server.camera.health.stamps import silence_text
from server.vision.contracts import Image

BEFORE = 14


def codes(findings: tuple[Finding, ...]) -> set[FaultCode]:
    return {finding.code for finding in findings}


def settled(camera: Camera, health: ImageHealth, count: int = BEFORE) -> StereoFrame:
    """Good pairs at rest; the last of them."""
    frame = camera.next()
    for _ in range(count):
        assert health.before_use(frame) == ()
        frame = camera.next()
    assert health.before_use(frame) == ()
    return frame


def blur(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 3.0), np.uint8)


def banded(image: Image) -> Image:
    gain = 1.0 + 0.2 * np.sin(2.0 * np.pi * np.arange(HEIGHT) / HEIGHT)
    return np.clip(image * gain[:, None], 0, 255).astype(np.uint8)


def mostly(image: Image, grey: int) -> Image:
    out = image.copy()
    out[:, : int(0.75 * WIDTH)] = grey
    return out


def broken(image: Image) -> Image:
    out = image.copy()
    out[400:] = np.roll(image[400:], 300, axis=1) // 2 + 90
    return out


PICTURES = {
    "black": (lambda left, right: (left // 64, right // 64), FaultCode.BLACK, "both eyes are black"),
    "mostly black": (lambda left, right: (mostly(left, 3), mostly(right, 3)), FaultCode.BLACK, "% of both eyes"),
    "white": (lambda left, right: (left | 255, right | 255), FaultCode.SATURATED, "both eyes are saturated"),
    "mostly white": (lambda left, right: (mostly(left, 255), right), FaultCode.SATURATED, "the left eye is saturated"),
    "left black": (lambda left, right: (left // 64, right), FaultCode.EYE_GONE, "the left eye is black"),
    "right grey": (lambda left, right: (left, right // 255 + 128), FaultCode.EYE_GONE, "the right eye shows nothing"),
    "copied": (lambda left, _right: (left, left), FaultCode.EYE_COPIED, "both eyes show the same picture"),
    "swapped": (lambda left, right: (right, left), FaultCode.EYES_SWAPPED, "exchange"),
    "blurred": (lambda left, right: (blur(left), blur(right)), FaultCode.BLURRED, "the left eye is blurred"),
    "one blurred": (lambda left, right: (left, blur(right)), FaultCode.BLURRED, "the right eye is blurred"),
    "banded": (lambda left, right: (banded(left), banded(right)), FaultCode.UNEVEN_EXPOSURE, "within the picture"),
    "brighter": (lambda left, right: (left // 8 * 9, right // 8 * 9), FaultCode.FLICKER, "brightness changed"),
    "broken": (lambda left, right: (broken(left), broken(right)), FaultCode.GARBAGE, "garbage"),
    "small": (lambda left, right: (left[::2, ::2], right[::2, ::2]), FaultCode.WRONG_SIZE, "640 x 360 px"),
    "no contrast": (lambda left, right: (left // 255 + 90, right // 255 + 90), FaultCode.NO_CONTRAST, "fog"),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_sick_pair_is_named_at_once_and_good_pairs_clear_it(name: str) -> None:
    make_sick, code, text = PICTURES[name]
    camera, health = Camera(), ImageHealth(CAMERA)
    settled(camera, health)
    found: tuple[Finding, ...] = ()
    for _ in range(7):  # the rig is examined in every sixth pair
        found = health.before_use(camera.frame(*make_sick(*camera.eyes())))
        if code in codes(found):
            break
        assert code is FaultCode.EYES_SWAPPED, f"found late: {found}"
    named = next(finding for finding in found if finding.code is code)
    assert text in named.text
    assert ";" in named.text  # the remedy
    assert named.forbids_look
    after = [health.before_use(camera.next()) for _ in range(3 * RECOVERY_PAIRS)]
    assert all(after[:RECOVERY_PAIRS])
    assert after[-1] == ()


@pytest.mark.parametrize("noise_grey", [0.7, 1.5, 3.0])
@pytest.mark.parametrize("qualities", [(95,), (95, 97, 93)])
def test_a_frozen_stream_is_found_whatever_its_stamps_and_its_compression(noise_grey: float, qualities: tuple) -> None:
    camera, health = Camera(noise_grey=noise_grey), ImageHealth(CAMERA)
    last = settled(camera, health)
    for number in range(6):
        camera.quality = qualities[number % len(qualities)]
        found = health.before_use(camera.frame(last.left, last.right))
        assert FaultCode.FROZEN in codes(found), number
        assert {"left" in finding.text for finding in found} == {True, False}


def test_one_frozen_eye_is_found_alone() -> None:
    camera, health = Camera(), ImageHealth(CAMERA)
    last = settled(camera, health)
    found = health.before_use(camera.frame(last.left, camera.eyes()[1]))
    assert [finding.code for finding in found] == [FaultCode.FROZEN]
    assert "left" in found[0].text


@pytest.mark.parametrize("noise_grey", [0.7, 1.5, 3.0])
@pytest.mark.parametrize("quality", [None, 95, 80])
def test_a_still_camera_is_not_frozen(noise_grey: float, quality: int | None) -> None:
    camera, health = Camera(noise_grey=noise_grey, quality=quality), ImageHealth(CAMERA)
    assert [found for _ in range(25) if (found := health.before_use(camera.next()))] == []


@pytest.mark.parametrize("contrast", [1.0, 0.25])
def test_a_camera_that_moves_and_stops_is_healthy(contrast: float) -> None:
    camera, health = Camera(contrast=contrast), ImageHealth(CAMERA)
    alarms = []
    for place in [*walk(60), *[(0, 0)] * 10]:
        camera.at_px = place
        alarms += health.before_use(camera.next())
    assert alarms == []


STAMPS = {
    "stands": ([-PERIOD_MS], FaultCode.STAMP_STANDS, "does not advance"),
    "runs backwards": ([-3 * PERIOD_MS], FaultCode.STAMP_BACKWARDS, "backwards by 66.0 ms"),
    "jumps ahead": ([700.0], FaultCode.STAMP_JUMPED, "ahead of their arrival by 700 ms"),
    "jumps back by less than a period": ([-20.0], FaultCode.STAMP_JUMPED, "a step of 13.0 ms"),
}


@pytest.mark.parametrize("name", STAMPS)
def test_sick_stamps_are_named_at_once(name: str) -> None:
    shifts, code, text = STAMPS[name]
    camera, health = Camera(), ImageHealth(CAMERA)
    settled(camera, health)
    found = health.before_use(moved_stamp(camera.next(), shifts[0]))
    assert codes(found) == {code}
    assert text in found[0].text
    again = [health.before_use(moved_stamp(camera.next(), shifts[0])) for _ in range(12)]
    if name != "stands":  # a clock that was set is a clock
        assert again[-1] == ()
    assert all(again[:8])


def test_an_old_picture_is_said_to_be_old_and_a_stall_is_no_jump() -> None:
    camera, health = Camera(), ImageHealth(CAMERA)
    settled(camera, health)
    late = camera.next()
    found = health.before_use(replace(late, t_receive_mono_ns=late.t_receive_mono_ns + 800 * MS))
    assert "800 ms older" in found[0].text
    camera, health = Camera(), ImageHealth(CAMERA)
    settled(camera, health)
    camera.number += 45  # 1.5 s without pictures, then all is as before
    assert health.before_use(camera.next()) == ()


def test_silence() -> None:
    assert silence_text(1_000 * MS, 1_400 * MS) == ()
    assert "no image for 0.6 s" in silence_text(1_000 * MS, 1_600 * MS)[0].text


@pytest.mark.parametrize(
    ("shift_px", "rows"), [(0, False), (2, False), (4, True), (12, True)], ids=lambda value: str(value)
)
def test_rows_that_differ_are_found_from_the_first_pair_on(shift_px: int, rows: bool) -> None:
    camera, health = Camera(), ImageHealth(CAMERA)
    left, right = camera.eyes()
    found = health.before_use(camera.frame(left, np.roll(right, shift_px, axis=0)))
    assert (FaultCode.ROWS_DIFFER in codes(found)) is rows


def test_a_lens_bow_that_the_file_does_not_tell_is_found() -> None:
    camera = Camera()
    bowed = ImageHealth(replace(CAMERA, distortion=(-0.12, 0.0, 0.0, 0.0, 0.0), rectified=False))
    straight = ImageHealth(CAMERA)
    found: set[FaultCode] = set()
    for place in walk(90, reach_px=40):
        camera.at_px = place
        frame = camera.next()
        found |= codes(bowed.before_use(frame))
        assert straight.before_use(frame) == ()
    assert found & {FaultCode.NOT_AS_CALIBRATED, FaultCode.ROWS_DIFFER}


def test_dirt_on_one_lens_is_found_while_the_scene_moves() -> None:
    camera, clean, dirty = Camera(), ImageHealth(CAMERA), ImageHealth(CAMERA)
    y, x = np.ogrid[:HEIGHT, :WIDTH]
    cover = 0.6 / (1.0 + np.exp((np.hypot(x - 700, y - 300) - 50.0) / 8.0))
    texts: list[str] = []
    for place in walk(130):
        camera.at_px = place
        left, right = camera.eyes()
        soft = cv2.GaussianBlur(left, (0, 0), 6.0)
        spotted = (left * (1.0 - cover) + 0.2 * cover * soft).astype(np.uint8)
        number = camera.number
        assert clean.before_use(camera.frame(left, right)) == ()
        camera.number = number
        texts += [finding.text for finding in dirty.before_use(camera.frame(spotted, right))]
    assert any("spot on the left lens" in text for text in texts)


def test_without_a_camera_file_size_and_rig_are_not_judged() -> None:
    camera, health = Camera(), ImageHealth()
    left, right = camera.eyes()
    assert health.check(camera.frame(right, left)) == ()
    assert "differ" not in "".join(health.check(camera.frame(left[::2, ::2], right[::2, ::2])))


def shelf(image: Image) -> Image:
    """Something dark in front of the lower part of the picture, its edge along the rows."""
    out = image.copy()
    out[520:] = out[520:] // 3 + 10
    return out


@pytest.mark.parametrize("name", ["black", "white", "frozen", "blurred"])
def test_a_scene_with_an_edge_along_its_rows_is_usable_again_after_a_fault(name: str) -> None:
    camera, health = Camera(), ImageHealth(CAMERA)
    good = lambda: camera.frame(*(shelf(eye) for eye in camera.eyes()))  # noqa: E731
    for _ in range(BEFORE + 4):  # blur is judged from the fifteenth picture on
        assert health.before_use(good()) == ()
    eyes = tuple(shelf(eye) for eye in camera.eyes())
    dark, white, soft = [eye // 64 for eye in eyes], [eye | 255 for eye in eyes], [blur(blur(eye)) for eye in eyes]
    grey = {"black": dark, "white": white, "frozen": eyes, "blurred": soft}[name]
    sick = [health.before_use(camera.frame(*grey)) for _ in range(5)]
    assert all(sick[1:])
    after = [health.before_use(good()) for _ in range(3 * RECOVERY_PAIRS)]
    assert after[-1] == ()


def in_turn(camera: Camera, change: Callable[[Image], Image], count: int) -> Iterator[StereoFrame]:
    """Pairs changed for long, of a few pictures in turn: each is unlike the one before."""
    pictures = [sent(*(change(eye) for eye in camera.eyes()), camera.quality) for _ in range(8)]
    for picture in islice(cycle(pictures), count):
        yield camera.stamped(picture)


def test_what_came_to_stay_in_front_of_the_camera_is_taken_for_the_scene_in_time() -> None:
    camera, health = Camera(), ImageHealth(CAMERA)
    settled(camera, health)
    found = [health.before_use(frame) for frame in in_turn(camera, shelf, 200)]
    assert FaultCode.GARBAGE in codes(found[0])
    assert found[-1] == ()


def rows_missing(image: Image) -> Image:
    out = image.copy()
    out[600:] = 128
    return out


def test_rows_that_are_missing_for_long_are_never_taken_for_the_scene() -> None:
    camera, health = Camera(), ImageHealth(CAMERA)
    settled(camera, health)
    for frame in in_turn(camera, rows_missing, 200):
        assert FaultCode.GARBAGE in codes(health.before_use(frame))
