"""Where an eye sees the machine itself: by the settings, and proposed from what stood still while the camera moved."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from machine.description import StereoCamera
from server.camera.check_findings import CheckFinding, Level
from server.errors import SettingsError
from server.settings_camera import Mask
from server.vision.contracts import Array, Image

BLOCK_PX = 16
PAIRS_MIN = 5
# Of the blocks change least over time: what changes there is noise, or the camera saw no still part
NOISE_BLOCKS_PERCENTILE = 5.0
TEXTURE_MIN_SIGMAS = 1.0  # of a block, in sigmas of the noise: below it nothing says whether it moved
# Change over time by texture: blocks that keep still have noise only, those that move about 1
STILL_CHANGE_MAX_FRAC = 0.35
MOVED_CHANGE_MIN_FRAC = 0.7
MOVED_BLOCKS_MIN_FRAC = 0.2  # of all blocks with texture: fewer, and the camera stood
UNMASKED_AREA_MIN_FRAC = 0.02  # of the picture; outlines of blocks differ by less from run to run
STILL_BLOCKS_MIN = 4  # of a part; fewer are chance
OUTLINE_TOLERANCE_PX = 1.5  # an outline may be so far from the mask that it follows
MASK_DILATION_BLOCKS = 1  # a mask reaches so far beyond what was seen: a corner's patch must not touch it


Masks = tuple[Sequence[Array], Sequence[Array]]


def still_mask(images: Sequence[Image]) -> Image | None:
    """A mask (h, w), 255 over what stood still in one eye's pictures (h, w); None where the camera did not move.

    Model:   by blocks: variance of grey over time against that over the block, each less the noise's. Of a moving
             texture they are alike, of one that stands still the first is 0. Plain blocks say nothing: they are taken
             where they hang together with still ones (morphological reconstruction).
    """
    if len(images) < PAIRS_MIN:
        return None
    stack = np.stack([image.astype(np.float64) for image in images])
    over_time, over_block = _block_means(stack.var(axis=0)), _mean_block_variance(stack)
    noise = max(
        float(np.percentile(over_time, NOISE_BLOCKS_PERCENTILE)), 0.25
    )  # grey^2; half a grey level is what 8 bits leave
    change, texture = np.maximum(over_time - noise, 0.0), np.maximum(over_block - noise, 1e-9)
    textured = texture > TEXTURE_MIN_SIGMAS**2 * noise
    ratio = np.sqrt(change / texture)
    moved = textured & (ratio > MOVED_CHANGE_MIN_FRAC)
    if moved.sum() < max(1.0, MOVED_BLOCKS_MIN_FRAC * textured.sum()):
        return None
    still = textured & (ratio < STILL_CHANGE_MAX_FRAC)
    open_to = cv2.morphologyEx(np.asarray(still | ~textured, np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    parts = np.asarray(cv2.connectedComponents(np.asarray(open_to, np.uint8), connectivity=4)[1], np.int64)
    counts = np.bincount(parts[still], minlength=int(parts.max()) + 1)
    own = (counts >= STILL_BLOCKS_MIN) & (np.arange(len(counts)) > 0)
    wide = np.asarray(
        cv2.dilate(own[parts].astype(np.uint8), np.ones((2 * MASK_DILATION_BLOCKS + 1,) * 2, np.uint8)), np.uint8
    )
    height, width = images[0].shape
    return np.asarray(255 * np.kron(wide, np.ones((BLOCK_PX, BLOCK_PX), np.uint8))[:height, :width], np.uint8)


def _block_means(values: Array) -> Array:
    """Means over blocks; what is left over at the right and below counts with the last ones."""
    height, width = values.shape
    rows, columns = -(-height // BLOCK_PX), -(-width // BLOCK_PX)
    padded = np.pad(values, ((0, rows * BLOCK_PX - height), (0, columns * BLOCK_PX - width)), mode="edge")
    return padded.reshape(rows, BLOCK_PX, columns, BLOCK_PX).mean(axis=(1, 3))


def _mean_block_variance(stack: Array) -> Array:
    """Variance of grey over each block, mean over the pictures."""
    return np.asarray(np.mean([_block_means(image**2) - _block_means(image) ** 2 for image in stack], axis=0))


def check_own_structure(pairs: Sequence[tuple[Image, Image]], masks: Masks = ((), ())) -> CheckFinding:
    """The line of the camera check: what of each eye stood still, and the settings that mask it."""
    found = [still_mask([pair[eye] for pair in pairs]) for eye in range(2)]
    left, right = found
    if left is None or right is None:
        text = "the image did not move, so the machine's own structure in it is unknown"
        return CheckFinding("own structure", Level.OK, text)
    open_fracs = [uncovered_frac(mask, polygons) for mask, polygons in zip((left, right), masks, strict=True)]
    shares = [float((mask > 0).mean()) for mask in (left, right)]
    figures = {
        "left_frac": shares[0],
        "right_frac": shares[1],
        "left_unmasked_frac": open_fracs[0],
        "right_unmasked_frac": open_fracs[1],
    }
    text = (
        f"{100 * shares[0]:.0f} % of the left and {100 * shares[1]:.0f} % of the right picture move with the camera; "
        f"{100 * open_fracs[0]:.0f} % and {100 * open_fracs[1]:.0f} % are not masked"
    )
    if max(open_fracs) < UNMASKED_AREA_MIN_FRAC:
        return CheckFinding("own structure", Level.OK, text, figures=figures)
    remedy = f"put into [camera] of the settings: {mask_line('left', left)} {mask_line('right', right)}"
    return CheckFinding("own structure", Level.WARN, text, remedy, figures)


def draw_mask(shape: tuple[int, ...], polygons: Sequence[Array]) -> Image:
    """A mask (h, w), 255 inside the polygons (k, 2) [px]."""
    mask = np.zeros(shape, np.uint8)
    for polygon in polygons:
        cv2.fillPoly(mask, [np.round(polygon).astype(np.int32).reshape(-1, 1, 2)], 255)
    return mask


def uncovered_frac(mask: Image, polygons: Sequence[Array]) -> float:
    """Share of the picture that the mask has and the polygons have not."""
    return float(((mask > 0) & (draw_mask(mask.shape, polygons) == 0)).mean())


class SpreadPairs:
    """A few pairs of a run, spread evenly over it however long it lasts."""

    def __init__(self) -> None:
        self._pairs: list[tuple[Image, Image]] = []
        self._count, self._every = 0, 1

    def add(self, left: Image, right: Image) -> None:
        """The run's next pair."""
        if self._count % self._every == 0:
            self._pairs.append((left.copy(), right.copy()))
        self._count += 1
        if len(self._pairs) > 2 * PAIRS_MIN:
            self._pairs, self._every = self._pairs[::2], 2 * self._every

    def masks(self) -> tuple[Image | None, Image | None]:
        """`still_mask` of the left and the right eye."""
        return still_mask([left for left, _ in self._pairs]), still_mask([right for _, right in self._pairs])


def mask_line(eye: str, mask: Image | None) -> str:
    """A line of TOML for [camera]."""
    polygons = () if mask is None else mask_outlines(mask)
    texts = ", ".join("[" + ", ".join(f"[{u:.0f}, {v:.0f}]" for u, v in polygon) + "]" for polygon in polygons)
    return f"mask_{eye} = [{texts}]"


def mask_polygons(mask: Mask, camera: StereoCamera, name: str) -> tuple[Array, ...]:
    """Polygons (k, 2) [px] of a mask in the settings.

    Raises: SettingsError: its picture cannot be read, or is not of the camera's size.
    """
    if not isinstance(mask, str):
        return tuple(np.array(polygon, dtype=float) for polygon in mask)
    try:
        data = Path(mask).read_bytes()
    except OSError as error:
        raise SettingsError(f"[camera] {name} = '{mask}': {error.strerror}; give a picture file or polygons") from error
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if picture is None:
        raise SettingsError(f"[camera] {name} = '{mask}' is not a picture; give a PNG, white where the machine is seen")
    found, wanted = (picture.shape[1], picture.shape[0]), (camera.width_px, camera.height_px)
    if found != wanted:
        raise SettingsError(
            f"[camera] {name} = '{mask}' is {found[0]} x {found[1]} px, an eye's picture {wanted[0]} x {wanted[1]} px; "
            "make the mask in that size"
        )
    return mask_outlines(np.asarray(picture >= 128, np.uint8))


def mask_outlines(mask: Image) -> tuple[Array, ...]:
    """Polygons (k, 2) [px] around what is not 0 in a mask (h, w); holes are covered too."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    simple = (
        np.asarray(cv2.approxPolyDP(contour, OUTLINE_TOLERANCE_PX, True), float).reshape(-1, 2) for contour in contours
    )
    return tuple(polygon for polygon in simple if len(polygon) >= 3)
