"""A straight white cover over a marker's border leaves clean sides at the wrong place: the printed cells tell."""

import cv2
import numpy as np
import pytest

from server.vision.border_fit import CELL_MIN_PX, border_covered, printed_pattern, sides_moved_in
from server.vision.edge_fit import SideFit
from server.vision.marker_search import dictionary_by_name, find_markers, marker_cells, refined_marker

FINE = 6  # pictures are drawn finer and averaged
NAMES = ("DICT_4X4_50", "DICT_APRILTAG_36h11")


def drawn(
    name: str, covered_frac: float = 0.0, side: int = 0, size_px: float = 96.0, seed: int = 0, light: float = 1.0
):
    """A marker, turned and tilted, one side's last share white; `light`: of the left margin against the right one."""
    dictionary = dictionary_by_name(name)
    cells, rng = int(dictionary.markerSize) + 2, np.random.default_rng(seed)
    printed = np.rot90(cv2.aruco.generateImageMarker(dictionary, 3, 100 * cells), side).copy()
    printed[round((1.0 - covered_frac) * len(printed)) :] = 255
    printed = np.rot90(printed, -side)
    turn, tilt, width = rng.uniform(0.0, 2.0 * np.pi), np.deg2rad(rng.uniform(0.0, 45.0)), int(2.0 * size_px) + 20
    square = 0.5 * size_px * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    depth = 1.0 + square[:, 1] * np.sin(tilt) / (4.0 * size_px)
    flat = np.column_stack([square[:, 0], square[:, 1] * np.cos(tilt)]) / depth[:, None]
    c, s = np.cos(turn), np.sin(turn)
    corners = flat @ np.array([[c, s], [-s, c]]) + 0.5 * width
    ends = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * len(printed) - 0.5
    H = cv2.getPerspectiveTransform(ends.astype(np.float32), ((corners + 0.5) * FINE - 0.5).astype(np.float32))
    page = np.full((width * FINE, width * FINE), 185.0, np.float32)
    ink = (15.0 + 170.0 / 255.0 * printed).astype(np.float32)
    cv2.warpPerspective(ink, H, page.shape, dst=page, borderMode=cv2.BORDER_TRANSPARENT, flags=cv2.INTER_AREA)
    seen = cv2.resize(cv2.GaussianBlur(page, (0, 0), 0.8 * FINE), (width, width), interpolation=cv2.INTER_AREA)
    seen = seen * np.linspace(light, 1.0, width)[None, :] + rng.normal(0.0, 2.0, seen.shape)
    return np.clip(np.round(seen), 0, 255).astype(np.uint8), dictionary


def fit_of(image, dictionary):
    (found,) = find_markers(image, dictionary)
    return refined_marker(found, image, dictionary, None)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("side", range(4))
@pytest.mark.parametrize("covered_frac", [0.03, 0.05])
def test_a_covered_border_is_told_whichever_side_it_is(name, side, covered_frac):
    for seed in range(3):
        assert fit_of(*drawn(name, covered_frac, side, seed=seed)).side_fit is not SideFit.CLEAN


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("size_px", "light"), [(40.0, 1.0), (96.0, 1.0), (160.0, 1.0), (96.0, 0.4)])
def test_an_open_one_is_clean_in_any_posture_and_uneven_light(name, size_px, light):
    for seed in range(8):
        assert fit_of(*drawn(name, size_px=size_px, seed=seed, light=light)).side_fit is SideFit.CLEAN, seed


def test_a_side_is_found_by_as_much_as_it_lies_too_far_in():
    image, dictionary = drawn("DICT_4X4_50", seed=1)
    marker, pattern = fit_of(image, dictionary), printed_pattern(marker_cells(dictionary, 3))
    corners = marker.corners_px
    assert np.abs(sides_moved_in(image, corners, pattern)).max() < 0.03
    short = corners.copy()
    short[1] += 0.1 / 6.0 * (corners[2] - corners[1])
    short[0] += 0.1 / 6.0 * (corners[3] - corners[0])
    assert sides_moved_in(image, short, pattern)[0] == pytest.approx(0.1, abs=0.03)


def test_small_cells_and_the_pictures_edge_say_nothing():
    pattern = printed_pattern(marker_cells(dictionary_by_name("DICT_4X4_50"), 3))
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    blank = np.zeros((60, 60), np.uint8)
    assert not border_covered(blank, 20.0 + 0.9 * CELL_MIN_PX * 6.0 * square, pattern)
    assert not border_covered(blank, 80.0 * square, pattern)
    assert not border_covered(blank, 10.0 + 40.0 * square, pattern)
    assert not border_covered(blank, np.full((4, 2), np.nan), pattern)
