"""The time code in the simulated picture survives scaling and compression."""

import cv2
import numpy as np
import pytest

from sim_plc.camera.process import (
    TIME_CODE_BITS,
    TIME_CODE_CELLS,
    TIME_CODE_HEIGHT_FRAC,
    TIME_CODE_UNIT_NS,
    paint_time_code,
)
from sim_plc.camera.texture import Grey

PICTURE = np.random.default_rng(3).integers(0, 255, (720, 1280), dtype=np.uint8)


def read(image: Grey, t_near_ns: int) -> int | None:
    """The time [mono ns] nearest to `t_near_ns` that a picture of any size carries; None when there is no code."""
    row = image[max(1, round(0.5 * TIME_CODE_HEIGHT_FRAC * image.shape[0]))].astype(float)
    centres = ((np.arange(TIME_CODE_CELLS) + 0.5) * image.shape[1] / TIME_CODE_CELLS).astype(int)
    levels = row[centres]
    if levels[0] - levels[1] < 100.0:
        return None
    bits = levels[2:] > 0.5 * (levels[0] + levels[1])
    code = int("".join("1" if bit else "0" for bit in bits), 2)
    span = (1 << TIME_CODE_BITS) * TIME_CODE_UNIT_NS
    turns = round((t_near_ns - code * TIME_CODE_UNIT_NS) / span)
    return code * TIME_CODE_UNIT_NS + turns * span


@pytest.mark.parametrize("width", [1280, 960, 700])
@pytest.mark.parametrize("t_ns", [0, 123_456_700_000, 86_400_000_000_000 * 5 + 1_700_000])
def test_what_was_painted_is_read(width, t_ns):
    jpeg = cv2.imencode(".jpg", paint_time_code(PICTURE, t_ns), [cv2.IMWRITE_JPEG_QUALITY, 60])[1]
    small = cv2.resize(cv2.imdecode(jpeg, 0), (width, round(width * 720 / 1280)), interpolation=cv2.INTER_AREA)
    assert read(small, t_ns + 3_000_000_000) == t_ns - t_ns % 100_000


def test_a_picture_without_code_tells_nothing():
    assert read(np.full((720, 1280), 90, np.uint8), 0) is None


def test_the_rest_of_the_picture_is_untouched():
    assert np.array_equal(paint_time_code(PICTURE, 5)[24:], PICTURE[24:])
