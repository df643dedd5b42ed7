"""The rock wall's print: a seeded grey texture with detail at all scales, and its prefiltered half-octave levels."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]
Field = NDArray[np.float32]

TEXEL_M = 0.0008
COLUMNS, ROWS = 5120, 4096  # 4.10 m x 3.28 m, repeating beyond
MEAN_GREY = 118.0
SIGMA_GREY = 42.0  # at full contrast
_N_LEVELS = 9  # half octaves: the coarsest texel is 16 times the finest
_OCTAVE_CELLS_M = (0.8, 0.4, 0.2, 0.1, 0.05, 0.025, 0.0125, 0.0064, 0.0032)
_OCTAVE_GAIN = 0.8  # amplitude of each octave against the one before
_FACET_SIZES_M = (0.30, 0.16, 0.08, 0.04, 0.022)  # flat chips with straight edges: corners at every distance
_FACET_COVER = 0.30  # mean cover of the wall by the chips of one size
_N_CRACKS = 260
_SPECKLE_SIZES_TEXEL = (2, 4, 8, 14)
_SPECKLE_COVER = 0.035


@dataclass(frozen=True, slots=True)
class TextureLevel:
    """One prefiltered copy. One extra row and column repeat the first, so that bilinear reads need no wrap inside.

    A wall point (x, y) [m, OOI axes, y up] is read at column x / texel_x_m - 0.5, row -y / texel_y_m - 0.5, modulo the
    size: all levels share the outer edge of their first texel.
    """

    grey_image: Grey
    texel_x_m: float
    texel_y_m: float


def value_noise(rng: np.random.Generator, rows: int, cols: int, cells_y: int, cells_x: int) -> Field:
    """Smooth periodic noise (rows, cols), zero mean, with `cells_y` x `cells_x` random values per period."""
    values = rng.standard_normal((cells_y, cells_x)).astype(np.float32)
    pad = 3
    padded = np.pad(values, pad, mode="wrap")
    size = (round(cols * padded.shape[1] / cells_x), round(rows * padded.shape[0] / cells_y))
    big = cv2.resize(padded, size, interpolation=cv2.INTER_CUBIC)
    top, left = round(pad * rows / cells_y), round(pad * cols / cells_x)
    return np.ascontiguousarray(big[top : top + rows, left : left + cols], np.float32)


def _octave_noise(rng: np.random.Generator) -> Field:
    """Sum of noises from coarse to fine, each drawn at the size it needs and enlarged together with those before it."""
    field = np.zeros((ROWS // 16, COLUMNS // 16), np.float32)
    gain = 1.0
    for cell_m in _OCTAVE_CELLS_M:
        cells_y, cells_x = round(ROWS * TEXEL_M / cell_m), round(COLUMNS * TEXEL_M / cell_m)
        while field.shape[1] < min(4 * cells_x, COLUMNS):
            field = _double_periodic_field(field)
        rows, cols = field.shape
        cv2.scaleAdd(value_noise(rng, rows, cols, cells_y, cells_x), gain, field, field)
        gain *= _OCTAVE_GAIN
    return field / np.float32(field.std())


def _double_periodic_field(field: Field) -> Field:
    """A periodic field at twice its size."""
    padded = np.pad(field, 1, mode="wrap")
    big = cv2.resize(padded, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(big[2:-2, 2:-2], np.float32)


def _periodic_shape_copies(points: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """A shape and its copies that reach in from the neighbouring periods."""
    x_min, y_min = points.min(axis=0)
    x_max, y_max = points.max(axis=0)
    shifts_x = [0] + [COLUMNS] * bool(x_min < 0) + [-COLUMNS] * bool(x_max >= COLUMNS)
    shifts_y = [0] + [ROWS] * bool(y_min < 0) + [-ROWS] * bool(y_max >= ROWS)
    return [points + np.array([dx, dy], np.int32) for dx in shifts_x for dy in shifts_y]


def _facet_tone_field(rng: np.random.Generator) -> Field:
    """Convex chips of random tone, the large ones below the small ones; 0 where there is none."""
    field = np.zeros((ROWS, COLUMNS), np.float32)
    for size_m in _FACET_SIZES_M:
        size = size_m / TEXEL_M
        n = round(_FACET_COVER * ROWS * COLUMNS / (0.6 * size * size))
        centres = rng.uniform((0, 0), (COLUMNS, ROWS), (n, 2))
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, (n, 6)), axis=1)
        radii = 0.5 * size * rng.uniform(0.6, 1.3, (n, 1)) * np.array([1.0, 0.7])
        turns = rng.uniform(0.0, np.pi, n)
        tones = rng.normal(0.0, 1.0, n)
        for centre, angle, radius, turn, tone in zip(centres, angles, radii, turns, tones, strict=True):
            c, s = np.cos(turn), np.sin(turn)
            ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius @ np.array([[c, s], [-s, c]])
            for points in _periodic_shape_copies(np.rint(ring + centre).astype(np.int32)):
                cv2.fillConvexPoly(field, points, float(tone), cv2.LINE_8)
    return field


def _crack_mask(rng: np.random.Generator) -> Grey:
    """Dark branching lines as a mask (255 = crack)."""
    mask = np.zeros((ROWS, COLUMNS), np.uint8)
    for _ in range(_N_CRACKS):
        n = int(rng.integers(8, 40))
        heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(rng.normal(0.0, 0.35, n))
        steps = rng.uniform(10, 45, (n, 1)) * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        path = rng.uniform((0, 0), (COLUMNS, ROWS)) + np.cumsum(steps, axis=0)
        width = int(rng.integers(1, 6))
        for points in _periodic_shape_copies(np.rint(path).astype(np.int32)):
            cv2.polylines(mask, [points], False, 255, width, cv2.LINE_AA)
    return mask


def _speckle_field(rng: np.random.Generator) -> Field:
    """Square-ish bright and dark grains of several sizes."""
    field = np.zeros((ROWS, COLUMNS), np.float32)
    for size in _SPECKLE_SIZES_TEXEL:
        n = round(_SPECKLE_COVER * ROWS * COLUMNS / (size * size))
        y = rng.integers(0, ROWS - size, n)
        x = rng.integers(0, COLUMNS - size, n)
        seeds = np.zeros((ROWS, COLUMNS), np.float32)
        seeds[y, x] = rng.normal(0.0, 1.0, n).astype(np.float32)
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)).astype(np.float32)
        field += cv2.filter2D(seeds, cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT)
    return np.clip(field, -2.0, 2.0)


def rock_texture(seed: int, contrast_frac: float) -> Grey:
    """The wall's grey picture (ROWS, COLUMNS), periodic both ways.

    Args:    seed: the wall's own seed. contrast_frac: 0..1, scales every departure from the mean grey.
    """
    rng = np.random.default_rng([seed, 0x726F636B])
    field = 0.7 * _octave_noise(rng)
    field += 0.75 * _facet_tone_field(rng)
    field += 0.8 * _speckle_field(rng)
    field -= (1.8 / 255.0) * _crack_mask(rng).astype(np.float32)
    field -= np.float32(field.mean())
    field *= np.float32(contrast_frac * SIGMA_GREY / field.std())
    return np.clip(field + MEAN_GREY, 4.0, 250.0).astype(np.uint8)


def texture_levels(base: Grey) -> tuple[TextureLevel, ...]:
    """Prefiltered copies, each texel sqrt(2) times as wide as the one before; level 0 is the base."""
    rows, cols = base.shape
    width_m, height_m = cols * TEXEL_M, rows * TEXEL_M
    levels = []
    for k in range(_N_LEVELS):
        size = (round(cols / 2 ** (k / 2)), round(rows / 2 ** (k / 2)))
        image = base if k == 0 else cv2.resize(base, size, interpolation=cv2.INTER_AREA)
        padded = np.pad(np.asarray(image, np.uint8), ((0, 1), (0, 1)), mode="wrap")
        levels.append(TextureLevel(padded, width_m / size[0], height_m / size[1]))
    return tuple(levels)


def best_level(levels: tuple[TextureLevel, ...], footprint_m: float) -> int:
    """The level whose texel, box filtered and read bilinearly, blurs like one pixel of this footprint.

    Model:   box of width t read bilinearly has variance t^2/12 + t^2/6; one pixel has p^2/12: t = p / sqrt(3).
    """
    wanted = footprint_m / np.sqrt(3.0)
    return int(np.argmin([abs(np.log(level.texel_x_m / wanted)) for level in levels]))
