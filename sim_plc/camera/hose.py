"""Paints one hose: a tube along a line in the picture, its skin stuck to it, with soft edges."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from machine.rotations import Array
from sim_plc.camera.texture import Grey


@dataclass(frozen=True, slots=True)
class HoseInEye:
    """`centre_line_px` (n, 2) in the picture from the tool on, `radius_px` (n,), `skin_row` (n,)."""

    centre_line_px: Array
    radius_px: Array
    skin_row: Array


@njit(cache=True, nogil=True, fastmath=True)
def paint_hose(out: Grey, pixels: Array, radius_px: Array, skin_row: Array, skin: Grey) -> None:
    """Paint a tube over a picture, in place.

    A pixel belongs to the piece of line between whose two bisectors it lies, so that none is painted twice.
    """
    height, width = out.shape
    n = len(radius_px)
    tangents = np.empty((n - 1, 2))
    for k in range(n - 1):
        step = pixels[k + 1] - pixels[k]
        tangents[k] = step / max(np.hypot(step[0], step[1]), 1e-9)
    for k in range(n - 1):
        a, b, t = pixels[k], pixels[k + 1], tangents[k]
        length = max(np.hypot(b[0] - a[0], b[1] - a[1]), 1e-9)
        before = t + tangents[max(k - 1, 0)]
        after = t + tangents[min(k + 1, n - 2)]
        reach = max(radius_px[k], radius_px[k + 1]) + 1.0
        u0, u1 = max(int(min(a[0], b[0]) - reach), 0), min(int(max(a[0], b[0]) + reach) + 2, width)
        v0, v1 = max(int(min(a[1], b[1]) - reach), 0), min(int(max(a[1], b[1]) + reach) + 2, height)
        for v in range(v0, v1):
            dv = v - a[1]
            low, high = u0, u1
            if abs(t[1]) > 1e-3:  # only the columns that the tube can reach in this row
                middle, half = a[0] + dv * t[0] / t[1], reach / abs(t[1])
                low, high = max(low, int(middle - half)), min(high, int(middle + half) + 2)
            for u in range(low, high):
                du = u - a[0]
                if du * before[0] + dv * before[1] < 0.0 or (u - b[0]) * after[0] + (v - b[1]) * after[1] >= 0.0:
                    continue
                along = min(max((du * t[0] + dv * t[1]) / length, 0.0), 1.0)
                across = du * t[1] - dv * t[0]
                radius = radius_px[k] + along * (radius_px[k + 1] - radius_px[k])
                cover = min(radius - abs(across) + 0.5, 1.0)
                if cover <= 0.0:
                    continue
                row = skin_row[k] + along * (skin_row[k + 1] - skin_row[k])
                grey = cover * _skin_grey(skin, row, across / radius) + (1.0 - cover) * out[v, u]
                out[v, u] = np.uint8(grey + 0.5)


@njit(cache=True, nogil=True, fastmath=True)
def _skin_grey(skin: Grey, row: float, share: float) -> float:
    """Grey of the skin at one row, and across the tube at -1..1 of its radius."""
    column = min(max(int(0.5 * (share + 1.0) * skin.shape[1]), 0), skin.shape[1] - 1)
    low = min(int(row), skin.shape[0] - 2)
    f = min(row - low, 1.0)
    return float((1.0 - f) * skin[low, column] + f * skin[low + 1, column])
