"""The wall: relief, ray intersection, and its image in one eye by a sparse map."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from machine.rotations import Array
from sim_plc.camera.texture import COLUMNS, ROWS, TEXEL_M, Grey, TextureLevel, value_noise

WIDTH_M, HEIGHT_M = COLUMNS * TEXEL_M, ROWS * TEXEL_M
_GRID = 256  # cells of the height field per period, each way
_RELIEF_CELLS_M = (1.0, 0.55)  # wavelengths of about two cells: slopes stay below about 0.3
_HOLLOW_RADIUS_M = 0.5  # the OOI hangs over a hollow, so that its boards clear the rock
_MAX_RANGE_M = 30.0  # rays that leave the wall's side end here
_FIRST_STEPS = 5  # at the start of a row, where no neighbour gives a first guess of the height


@dataclass(frozen=True, slots=True)
class Relief:
    """Height of the rock over the mean plane, periodic, bilinear; `heights_m` (grid + 1, grid + 1), rows along y."""

    heights_m: Array
    mean_z_m: float


def wall_relief(seed: int, relief_m: float, wall_offset_m: float) -> Relief:
    """A smooth seeded relief of exactly `relief_m` peak to peak about z_ooi = -wall_offset_m, hollow behind the OOI."""
    if relief_m == 0.0:
        return Relief(np.zeros((_GRID + 1, _GRID + 1)), -wall_offset_m)
    rng = np.random.default_rng([seed, 0x72656C])
    field = np.zeros((_GRID, _GRID))
    for amplitude, cell_m in zip((1.0, 0.35), _RELIEF_CELLS_M, strict=True):
        field += amplitude * value_noise(rng, _GRID, _GRID, round(HEIGHT_M / cell_m), round(WIDTH_M / cell_m))
    field = (field - field.min()) / np.ptp(field) - 0.5
    y, x = np.meshgrid(np.arange(_GRID) * HEIGHT_M / _GRID, np.arange(_GRID) * WIDTH_M / _GRID, indexing="ij")
    radius = np.hypot(np.minimum(x, WIDTH_M - x), np.minimum(y, HEIGHT_M - y))
    hollow = np.exp(-((radius / _HOLLOW_RADIUS_M) ** 4))
    field = (1.0 - hollow) * field - 0.5 * hollow
    field = (field - field.min()) / np.ptp(field) - 0.5
    return Relief(np.pad(field * relief_m, ((0, 1), (0, 1)), mode="wrap"), -wall_offset_m)


@njit(cache=True, nogil=True)
def height_at(heights: Array, x: float, y: float) -> float:
    """Bilinear, periodic height [m] at a wall point [m]."""
    n = heights.shape[0] - 1
    gx = x * (n / WIDTH_M)
    gy = y * (n / HEIGHT_M)
    fx, fy = np.floor(gx), np.floor(gy)
    ix, iy = int(fx) % n, int(fy) % n
    fx, fy = gx - fx, gy - fy
    low = heights[iy, ix] * (1.0 - fx) + heights[iy, ix + 1] * fx
    high = heights[iy + 1, ix] * (1.0 - fx) + heights[iy + 1, ix + 1] * fx
    return low * (1.0 - fy) + high * fy


@njit(cache=True, nogil=True)
def wall_hit(
    heights: Array, mean_z: float, guess: float, origin: Array, dx: float, dy: float, dz: float, steps: int
) -> tuple[float, float, float]:
    """Where the ray origin + t (dx, dy, dz) meets the wall: (x, y, height).

    Starts from a guess of the height; each step reads the height twice and extrapolates (Aitken).
    """
    if dz > -1e-6:
        return origin[0] + _MAX_RANGE_M * dx, origin[1] + _MAX_RANGE_M * dy, 0.0
    h = guess
    for _ in range(steps):
        t = (mean_z + h - origin[2]) / dz
        first = height_at(heights, origin[0] + t * dx, origin[1] + t * dy)
        t = (mean_z + first - origin[2]) / dz
        second = height_at(heights, origin[0] + t * dx, origin[1] + t * dy)
        bend = (second - first) - (first - h)
        h = second if abs(bend) < 1e-7 else second - (second - first) ** 2 / bend
    t = min((mean_z + h - origin[2]) / dz, _MAX_RANGE_M)
    return origin[0] + t * dx, origin[1] + t * dy, h


@njit(cache=True, nogil=True)
def pose_at_row(keys: Array, row: float, height_px: int, out: Array) -> None:
    """Pose of one image row between key poses (n, 4, 4) by linear interpolation of the entries, into `out` (3, 4)."""
    n = keys.shape[0]
    s = min(max(row / (height_px - 1), 0.0), 1.0) * (n - 1)
    k = min(int(s), n - 2)
    f = s - k
    for i in range(3):
        for j in range(4):
            out[i, j] = keys[k, i, j] * (1.0 - f) + keys[k + 1, i, j] * f


@njit(cache=True, nogil=True)
def node_map(
    nodes: Array, step_px: int, height_px: int, keys: Array, heights: Array, mean_z: float, flat: bool
) -> Array:
    """Wall points (x, y) [m] seen at the sparse nodes, (rows, cols, 2); `keys`: T_ooi_cam at the shutter's key rows."""
    rows, cols = nodes.shape[0], nodes.shape[1]
    steps = 0 if flat else 1
    out = np.empty((rows, cols, 2))
    T = np.empty((3, 4))
    for i in range(rows):
        pose_at_row(keys, (i - 1) * step_px, height_px, T)
        origin = T[:, 3].copy()
        h = 0.0
        for j in range(cols):
            x, y = nodes[i, j, 0], nodes[i, j, 1]
            dx = T[0, 0] * x + T[0, 1] * y + T[0, 2]
            dy = T[1, 0] * x + T[1, 1] * y + T[1, 2]
            dz = T[2, 0] * x + T[2, 1] * y + T[2, 2]
            count = _FIRST_STEPS if steps and j == 0 else steps
            out[i, j, 0], out[i, j, 1], h = wall_hit(heights, mean_z, h, origin, dx, dy, dz, count)
    return out


@njit(cache=True, nogil=True)
def _read_run(flat: Grey, pitch: int, rows: int, cols: int, x: int, y: int, dx: int, dy: int, run: Grey) -> None:
    """Grey of a short straight run of texels; x, y in 1/65536 texel; bilinear with 8-bit weights; wraps."""
    n = run.size
    low, high = min(y, y + n * dy), max(y, y + n * dy)
    left, right = min(x, x + n * dx), max(x, x + n * dx)
    inside = left >= 0 and low >= 0 and right < (cols << 16) and high < (rows << 16)
    for k in range(n):
        fx, fy = (x >> 8) & 255, (y >> 8) & 255
        ix, iy = x >> 16, y >> 16
        if not inside:
            ix, iy = ix % cols, iy % rows
        p = iy * pitch + ix
        top = flat[p] * (256 - fx) + flat[p + 1] * fx
        bottom = flat[p + pitch] * (256 - fx) + flat[p + pitch + 1] * fx
        run[k] = (top * (256 - fy) + bottom * fy + 32768) >> 16
        x += dx
        y += dy


@njit(cache=True, nogil=True)
def paint_map(nodes_texel: Array, step: int, image: Grey, out: Grey) -> None:
    """Fill `out` from a texture level through a bilinear map.

    `nodes_texel` (rows, cols, 2): column and row of the level at each node; pixel (0, 0) lies on node (1, 1).
    The level wraps; its last row and column repeat its first.
    """
    height, width = out.shape
    pitch = image.shape[1]
    flat = image.reshape(-1)
    n_cols = nodes_texel.shape[1]
    line_x = np.empty(n_cols, np.int64)
    line_y = np.empty(n_cols, np.int64)
    for v in range(height):
        i = v // step + 1
        f = (v % step) / step
        for j in range(n_cols):
            line_x[j] = int(((1.0 - f) * nodes_texel[i, j, 0] + f * nodes_texel[i + 1, j, 0]) * 65536.0)
            line_y[j] = int(((1.0 - f) * nodes_texel[i, j, 1] + f * nodes_texel[i + 1, j, 1]) * 65536.0)
        for c in range(width // step):
            dx, dy = (line_x[c + 2] - line_x[c + 1]) // step, (line_y[c + 2] - line_y[c + 1]) // step
            run = out[v, c * step : (c + 1) * step]
            _read_run(flat, pitch, image.shape[0] - 1, pitch - 1, line_x[c + 1], line_y[c + 1], dx, dy, run)


def texel_map(points: Array, level: TextureLevel) -> Array:
    """Columns and rows of a level for wall points (rows, cols, 2) [m], shifted by whole periods near zero."""
    texel = points * [1.0 / level.texel_x_m, -1.0 / level.texel_y_m] - 0.5
    size = [level.grey_image.shape[1] - 1, level.grey_image.shape[0] - 1]
    texel -= np.floor(texel[texel.shape[0] // 2, texel.shape[1] // 2] / size) * size
    return texel
