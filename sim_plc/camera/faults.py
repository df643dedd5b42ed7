"""Camera faults for tests, each as a real camera or its cable would send it; switched while pictures run.

A fault acts where it arises: in the scene (`faulty_scene`), in the pictures (`FaultSwitch.apply`), in the stamps
(`FaultSwitch.stamp`) or in the bytes on the wire (`FaultSwitch.sent`).
"""

from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING

import cv2
import numpy as np

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from sim_plc.camera.sensor import motion_blur
from sim_plc.camera.texture import Grey

if TYPE_CHECKING:
    from sim_plc.world import SceneTruth

# Image faults: shade, glare, blur, another lens, a bumped eye, flicker, dirt.

PictureFault = Callable[[Grey, Grey, int], tuple[Grey, Grey]]

COVERED_WIDTH_FRAC = 0.8
FAULT_BLUR_SIGMA_PX = 3.0
MOTION_SMEAR_PX = (14.0, 5.0)
FOCAL_LENGTH_WIDTH_FRAC = 0.4125  # of the width
DISTORTION_FILL_ZOOM = 1.25  # so that the bowed picture is filled but for its very corners
OTHER_K1, OTHER_K2 = -0.10, 0.010  # more than the nominal lens; such cameras' raw pictures have up to -0.17
ROLL_RAD, PITCH_RAD = np.deg2rad(0.3), np.deg2rad(0.35)
BUMPED_EYE_ROTATION_RAD = np.deg2rad(0.5)
FLICKER_AMPLITUDE_FRAC = 0.15
FLICKER_PHASE_STEP_RAD = 2.4  # from picture to picture, of a lamp at 100 Hz and a camera that is not in step with it
FLICKER_PHASE_PER_READOUT_RAD = 2.0 * np.pi * 1.1  # 11 ms of readout
LENS_SPOT_POSITION_FRAC = (0.62, 0.35)
SPOT_RADIUS_FRAC, SPOT_DEPTH = 0.045, 0.55


def partly_covered(image: Grey) -> Grey:
    """Most of the picture covered from the left; what is covered keeps a little noise."""
    out = image.copy()
    edge = int(COVERED_WIDTH_FRAC * image.shape[1])
    out[:, :edge] = image[:, :edge] // 32
    return out


def saturated(image: Grey) -> Grey:
    """A light that blinds: most pixels clip."""
    bright = image.astype(np.float32) * 1.5 + 140.0
    return np.minimum(bright, 255.0).astype(np.uint8)


def blurred(image: Grey) -> Grey:
    """Out of focus."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), FAULT_BLUR_SIGMA_PX), np.uint8)


def smeared(image: Grey) -> Grey:
    """Moved by 15 px during the exposure."""
    return motion_blur(image, np.array(MOTION_SMEAR_PX))


def _rotate_and_distort(
    image: Grey, rotvec: tuple[float, float, float], k1: float, k2: float, zoom: float = 1.0
) -> Grey:
    """The picture as an eye with this lens, turned by this rotation vector [rad], sees it."""
    height, width = image.shape
    focal = FOCAL_LENGTH_WIDTH_FRAC * width
    camera = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 1, 2).astype(np.float32)
    zoomed = camera * np.array([[zoom, 1.0, 1.0], [1.0, zoom, 1.0], [1.0, 1.0, 1.0]])
    rays = cv2.undistortPoints(grid, zoomed, np.array([k1, k2, 0.0, 0.0])).reshape(-1, 2)
    turned = np.column_stack([rays, np.ones(len(rays))]) @ np.asarray(cv2.Rodrigues(np.array(rotvec))[0]).T
    source = turned[:, :2] / turned[:, 2:] * focal + camera[:2, 2]
    maps = source.reshape(height, width, 2).astype(np.float32)
    seen = cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.uint8)


def other_lens(left: Grey, right: Grey) -> tuple[Grey, Grey]:
    """Raw pictures of a lens that bows more, its eyes not aligned, where pictures of the camera file's are expected."""
    return (
        _rotate_and_distort(left, (0.5 * PITCH_RAD, 0.0, 0.5 * ROLL_RAD), OTHER_K1, OTHER_K2, DISTORTION_FILL_ZOOM),
        _rotate_and_distort(right, (-0.5 * PITCH_RAD, 0.0, -0.5 * ROLL_RAD), OTHER_K1, OTHER_K2, DISTORTION_FILL_ZOOM),
    )


def tilted_upward(image: Grey) -> Grey:
    """The eye turned up by half a degree."""
    return _rotate_and_distort(image, (BUMPED_EYE_ROTATION_RAD, 0.0, 0.0), 0.0, 0.0)


def _scale_brightness(image: Grey, gain: float | np.ndarray) -> Grey:
    return np.clip(image * gain + 0.5, 0.0, 255.0).astype(np.uint8)


def flickering(image: Grey, number: int) -> Grey:
    """Picture `number` under a lamp that flickers."""
    return _scale_brightness(image, 1.0 + FLICKER_AMPLITUDE_FRAC * np.sin(FLICKER_PHASE_STEP_RAD * number))


def with_flicker_bands(image: Grey, number: int) -> Grey:
    """The same with a rolling shutter: rows in bands, which wander."""
    rows = np.arange(image.shape[0])[:, None] / image.shape[0]
    return _scale_brightness(
        image,
        1.0 + FLICKER_AMPLITUDE_FRAC * np.sin(FLICKER_PHASE_PER_READOUT_RAD * rows + FLICKER_PHASE_STEP_RAD * number),
    )


def spotted(image: Grey) -> Grey:
    """Dirt close to the lens: a dark spot with soft edges."""
    height, width = image.shape
    radius = SPOT_RADIUS_FRAC * width
    distance = np.hypot(
        np.arange(width) - LENS_SPOT_POSITION_FRAC[0] * width,
        (np.arange(height) - LENS_SPOT_POSITION_FRAC[1] * height)[:, None],
    )
    cover = SPOT_DEPTH / (1.0 + np.exp((distance - radius) / (0.15 * radius)))
    soft = cv2.GaussianBlur(image, (0, 0), 6.0)
    return np.clip(image * (1.0 - cover) + cover * 0.25 * soft, 0.0, 255.0).astype(np.uint8)


STAMP_AHEAD_NS = 700_000_000
STAMP_STEP_BACK_NS = 300_000_000
MARKER_SHIFT_M = 0.008
MARKER_ROTATION_RAD = np.deg2rad(3.0)
DUPLICATE_MARKER_OFFSET_M = (-0.35, 0.25, 0.0)  # from the OOI's middle: next to and above its markers, on the open wall
REENCODED_JPEG_QUALITIES = (95, 93, 96, 94, 97)
GARBAGE_START_FRAC = 0.4  # of the bytes


class FaultKind(Enum):
    """What is wrong. Pictures go on and stamps advance unless the kind says otherwise."""

    NONE = "none"
    FREEZE = "freeze"
    FREEZE_RECODED = "freeze_recoded"  # the same picture, compressed again each time at a quality of its own
    LEFT_FREEZE = "left_freeze"
    RIGHT_FREEZE = "right_freeze"
    SILENT = "silent"  # no pictures at all
    BLACK = "black"
    MOSTLY_BLACK = "mostly_black"
    WHITE = "white"
    MOSTLY_WHITE = "mostly_white"
    LEFT_BLACK = "left_black"
    RIGHT_BLACK = "right_black"
    LEFT_GREY = "left_grey"
    RIGHT_GREY = "right_grey"
    LEFT_COPY = "left_copy"  # the left eye twice
    RIGHT_COPY = "right_copy"
    SWAPPED = "swapped"
    UNRECTIFIED = "unrectified"  # raw pictures of another lens, eyes not aligned
    BUMPED = "bumped"  # the right eye turned by half a degree
    BLUR = "blur"  # out of focus
    MOTION_BLUR = "motion_blur"
    LEFT_BLUR = "left_blur"
    SMALL = "small"  # another resolution
    GARBAGE = "garbage"  # bytes lost in the midst of the picture's data
    TRUNCATED = "truncated"  # its end is missing
    FLIPPED = "flipped"  # one to three bits of the picture's data
    FLICKER = "flicker"
    UNEVEN = "uneven"  # a lamp that flickers while the rows are read out
    SPOT = "spot"  # dirt on the left lens
    STAMP_AHEAD = "stamp_ahead"  # the camera's clock set forward once
    STAMP_BACK = "stamp_back"  # and back
    STAMP_STANDS = "stamp_stands"
    STAMP_REVERSED = "stamp_reversed"  # every stamp before the last one
    MARKER_TWICE = "marker_twice"  # a second print of an OOI marker
    MARKER_MOVED = "marker_moved"  # one OOI marker shifted and turned on its board


SCENE_FAULTS = frozenset({FaultKind.MARKER_TWICE, FaultKind.MARKER_MOVED})

_PICTURES: dict[FaultKind, PictureFault] = {
    FaultKind.BLACK: lambda left, right, _: (np.zeros_like(left), np.zeros_like(right)),
    FaultKind.MOSTLY_BLACK: lambda left, right, _: (partly_covered(left), partly_covered(right)),
    FaultKind.WHITE: lambda left, right, _: (np.full_like(left, 255), np.full_like(right, 255)),
    FaultKind.MOSTLY_WHITE: lambda left, right, _: (saturated(left), saturated(right)),
    FaultKind.LEFT_BLACK: lambda left, right, _: (np.zeros_like(left), right),
    FaultKind.RIGHT_BLACK: lambda left, right, _: (left, np.zeros_like(right)),
    FaultKind.LEFT_GREY: lambda left, right, _: (np.full_like(left, 128), right),
    FaultKind.RIGHT_GREY: lambda left, right, _: (left, np.full_like(right, 128)),
    FaultKind.LEFT_COPY: lambda left, _right, _: (left, left),
    FaultKind.RIGHT_COPY: lambda _left, right, _: (right, right),
    FaultKind.SWAPPED: lambda left, right, _: (right, left),
    FaultKind.UNRECTIFIED: lambda left, right, _: other_lens(left, right),
    FaultKind.BUMPED: lambda left, right, _: (left, tilted_upward(right)),
    FaultKind.BLUR: lambda left, right, _: (blurred(left), blurred(right)),
    FaultKind.LEFT_BLUR: lambda left, right, _: (blurred(left), right),
    FaultKind.MOTION_BLUR: lambda left, right, _: (smeared(left), smeared(right)),
    FaultKind.SMALL: lambda left, right, _: (_half_size_image(left), _half_size_image(right)),
    FaultKind.FLICKER: lambda left, right, n: (flickering(left, n), flickering(right, n)),
    FaultKind.UNEVEN: lambda left, right, n: (with_flicker_bands(left, n), with_flicker_bands(right, n)),
    FaultKind.SPOT: lambda left, right, _: (spotted(left), right),
}


class FaultSwitch:
    """Applies the chosen fault to every pair, its stamp and its bytes."""

    def __init__(self) -> None:
        self.kind = FaultKind.NONE
        self._last: tuple[Grey, Grey] | None = None
        self._last_stamp_ns: int | None = None
        self._number = 0

    def apply(self, left: Grey, right: Grey) -> tuple[Grey, Grey]:
        """The pair as the faulty camera gives it."""
        self._number += 1
        last = self._last
        if last is not None and self.kind in (FaultKind.FREEZE, FaultKind.FREEZE_RECODED):
            return last
        if last is not None and self.kind is FaultKind.LEFT_FREEZE:
            return last[0], right
        if last is not None and self.kind is FaultKind.RIGHT_FREEZE:
            return left, last[1]
        self._last = (left, right)
        fault = _PICTURES.get(self.kind)
        return (left, right) if fault is None else fault(left, right, self._number)

    def stamp(self, t_exposure_ns: int) -> int:
        """The stamp as the faulty camera gives it."""
        before = self._last_stamp_ns
        if self.kind is FaultKind.STAMP_AHEAD:
            return t_exposure_ns + STAMP_AHEAD_NS
        if self.kind is FaultKind.STAMP_BACK:
            return t_exposure_ns - STAMP_STEP_BACK_NS
        if before is not None and self.kind is FaultKind.STAMP_STANDS:
            return before
        if before is not None and self.kind is FaultKind.STAMP_REVERSED:
            return 2 * before - t_exposure_ns
        self._last_stamp_ns = t_exposure_ns
        return t_exposure_ns

    def sent(self, left: Grey, right: Grey, quality: int) -> bytes | None:
        """The side-by-side JPEG as it leaves the faulty camera; None when it sends nothing."""
        picture = np.hstack(self.apply(left, right))
        if self.kind is FaultKind.SILENT:
            return None
        if self.kind is FaultKind.FREEZE_RECODED:
            picture = _decode_jpeg(_encode_jpeg(picture, quality))  # what the frozen memory holds
            quality = REENCODED_JPEG_QUALITIES[self._number % len(REENCODED_JPEG_QUALITIES)]
        jpeg = _encode_jpeg(picture, quality)
        if self.kind is FaultKind.GARBAGE:
            return _with_lost_bytes(jpeg, self._number)
        if self.kind is FaultKind.FLIPPED:
            rng = np.random.default_rng(self._number)
            return with_flipped_bits(jpeg, int(rng.integers(1, 4)), rng)
        return jpeg[: int(0.6 * len(jpeg))] if self.kind is FaultKind.TRUNCATED else jpeg


def faulty_scene(kind: FaultKind, scene: "SceneTruth") -> "SceneTruth":
    """The scene as a fault of the markers leaves it; the same scene for every other kind."""
    *others, last = scene.ooi_markers
    if kind is FaultKind.MARKER_MOVED:
        turn = rotation_from_rotvec(np.array([0.0, 0.0, MARKER_ROTATION_RAD]))
        moved = replace(last, T_on_marker=last.T_on_marker @ pose(turn, np.array([MARKER_SHIFT_M, 0.0, 0.0])))
        return replace(scene, ooi_markers=(*others, moved))
    if kind is FaultKind.MARKER_TWICE:
        second = replace(last, T_on_marker=pose(np.eye(3), np.array(DUPLICATE_MARKER_OFFSET_M)))
        return replace(scene, ooi_markers=(*scene.ooi_markers, second))
    return scene


def _half_size_image(image: Grey) -> Grey:
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)


def _encode_jpeg(picture: Grey, quality: int) -> bytes:
    good, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not good:
        raise ValueError(f"picture {picture.shape} {picture.dtype} cannot be encoded as JPEG; give grey 8 bit")
    return jpeg.tobytes()


def _decode_jpeg(jpeg: bytes) -> Grey:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE), np.uint8)


def with_flipped_bits(jpeg: bytes, n_bits: int, rng: np.random.Generator) -> bytes:
    """The same picture with so many bits of its entropy-coded data flipped, at random places."""
    damaged = bytearray(jpeg)
    first = jpeg.index(b"\xff\xda") + 14  # behind the head of a colour picture's scan; a grey one's is shorter
    for bit in rng.integers(8 * first, 8 * (len(jpeg) - 2), n_bits):
        damaged[bit // 8] ^= 1 << int(bit % 8)
    return bytes(damaged)


def _with_lost_bytes(jpeg: bytes, number: int) -> bytes:
    """A stretch of the entropy-coded data is missing, as when packets are lost; the end is there."""
    rng = np.random.default_rng(number)
    start = int(len(jpeg) * (GARBAGE_START_FRAC + 0.1 * rng.random()))
    lost = int(rng.integers(200, 3000))
    return jpeg[:start] + jpeg[start + lost :]
