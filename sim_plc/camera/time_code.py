"""A time code painted into the picture, so that a screenshot shows its exposure time.

42 cells in one row at the top: a white and a black one to find grey levels by, then 40 bits of the exposure on the
monotonic clock, in units of 0.1 ms, the highest first; wraps after 30 h.
"""

import numpy as np

from sim_plc.camera.texture import Grey

BITS = 40
CELLS = BITS + 2
UNIT_NS = 100_000
HEIGHT_FRAC = 24.0 / 720.0


def painted(image: Grey, t_mono_ns: int) -> Grey:
    """A copy of the picture with its code over the full width."""
    out = image.copy()
    height = max(4, round(HEIGHT_FRAC * image.shape[0]))
    code = (t_mono_ns // UNIT_NS) % (1 << BITS)
    levels = [1, 0, *((code >> (BITS - 1 - i)) & 1 for i in range(BITS))]
    edges = np.linspace(0, image.shape[1], CELLS + 1).round().astype(int)
    for level, start, end in zip(levels, edges[:-1], edges[1:], strict=True):
        out[:height, start:end] = 235 if level else 16
    return out


def read(image: Grey, t_near_ns: int) -> int | None:
    """The time [mono ns] nearest to `t_near_ns` that a picture of any size carries; None when there is no code."""
    row = image[max(1, round(0.5 * HEIGHT_FRAC * image.shape[0]))].astype(float)
    centres = ((np.arange(CELLS) + 0.5) * image.shape[1] / CELLS).astype(int)
    levels = row[centres]
    if levels[0] - levels[1] < 100.0:
        return None
    bits = levels[2:] > 0.5 * (levels[0] + levels[1])
    code = int("".join("1" if bit else "0" for bit in bits), 2)
    span = (1 << BITS) * UNIT_NS
    turns = round((t_near_ns - code * UNIT_NS) / span)
    return code * UNIT_NS + turns * span
