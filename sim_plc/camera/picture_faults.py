"""Image faults: shade, glare, blur, another lens, a bumped eye, flicker, dirt."""

from collections.abc import Callable

import cv2
import numpy as np

from sim_plc.camera.sensor import motion_blur
from sim_plc.camera.texture import Grey

PictureFault = Callable[[Grey, Grey, int], tuple[Grey, Grey]]

COVERED_FRAC = 0.8
BLUR_PX = 3.0
SMEAR_PX = (14.0, 5.0)
FOCAL_FRAC = 0.4125  # of the width
ZOOM = 1.25  # so that the bowed picture is filled but for its very corners
OTHER_K1, OTHER_K2 = -0.10, 0.010  # more than the nominal lens; such cameras' raw pictures have up to -0.17
ROLL_RAD, PITCH_RAD = np.deg2rad(0.3), np.deg2rad(0.35)
BUMP_RAD = np.deg2rad(0.5)
FLICKER_FRAC = 0.15
MAINS_STEP_RAD = 2.4  # from picture to picture, of a lamp at 100 Hz and a camera that is not in step with it
MAINS_PER_READOUT_RAD = 2.0 * np.pi * 1.1  # 11 ms of readout
SPOT_FRAC = (0.62, 0.35)
SPOT_RADIUS_FRAC, SPOT_DEPTH = 0.045, 0.55


def shaded(image: Grey) -> Grey:
    """Most of the picture covered from the left; what is covered keeps a little noise."""
    out = image.copy()
    edge = int(COVERED_FRAC * image.shape[1])
    out[:, :edge] = image[:, :edge] // 32
    return out


def saturated(image: Grey) -> Grey:
    """A light that blinds: most pixels clip."""
    bright = image.astype(np.float32) * 1.5 + 140.0
    return np.minimum(bright, 255.0).astype(np.uint8)


def blurred(image: Grey) -> Grey:
    """Out of focus."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), BLUR_PX), np.uint8)


def smeared(image: Grey) -> Grey:
    """Moved by 15 px during the exposure."""
    return motion_blur(image, np.array(SMEAR_PX))


def _turned(image: Grey, rotvec: tuple[float, float, float], k1: float, k2: float, zoom: float = 1.0) -> Grey:
    """The picture as an eye with this lens, turned by this rotation vector [rad], sees it."""
    height, width = image.shape
    focal = FOCAL_FRAC * width
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
        _turned(left, (0.5 * PITCH_RAD, 0.0, 0.5 * ROLL_RAD), OTHER_K1, OTHER_K2, ZOOM),
        _turned(right, (-0.5 * PITCH_RAD, 0.0, -0.5 * ROLL_RAD), OTHER_K1, OTHER_K2, ZOOM),
    )


def bumped(image: Grey) -> Grey:
    """The eye turned up by half a degree."""
    return _turned(image, (BUMP_RAD, 0.0, 0.0), 0.0, 0.0)


def _times(image: Grey, gain: float | np.ndarray) -> Grey:
    return np.clip(image * gain + 0.5, 0.0, 255.0).astype(np.uint8)


def flickering(image: Grey, number: int) -> Grey:
    """Picture `number` under a lamp that flickers."""
    return _times(image, 1.0 + FLICKER_FRAC * np.sin(MAINS_STEP_RAD * number))


def uneven(image: Grey, number: int) -> Grey:
    """The same with a rolling shutter: rows in bands, which wander."""
    rows = np.arange(image.shape[0])[:, None] / image.shape[0]
    return _times(image, 1.0 + FLICKER_FRAC * np.sin(MAINS_PER_READOUT_RAD * rows + MAINS_STEP_RAD * number))


def spotted(image: Grey) -> Grey:
    """Dirt close to the lens: a dark spot with soft edges."""
    height, width = image.shape
    radius = SPOT_RADIUS_FRAC * width
    distance = np.hypot(np.arange(width) - SPOT_FRAC[0] * width, (np.arange(height) - SPOT_FRAC[1] * height)[:, None])
    cover = SPOT_DEPTH / (1.0 + np.exp((distance - radius) / (0.15 * radius)))
    soft = cv2.GaussianBlur(image, (0, 0), 6.0)
    return np.clip(image * (1.0 - cover) + cover * 0.25 * soft, 0.0, 255.0).astype(np.uint8)
