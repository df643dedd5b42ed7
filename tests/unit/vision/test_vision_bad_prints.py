"""Prints that cannot be measured are named for what they are: no white margin, white on black."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from server.camera.health.blur import BlurMonitor
from server.settings import read_machine
from server.vision.aruco_source import ArucoPoseSource
from server.vision.contracts import NO_WHITE_MARGIN_REASON, MarkerView, PoseStatus
from server.vision.marker_search import dictionary_by_name

MACHINE = read_machine("hiab033")
PLACES = {10: (300, 420, 140), 1: (150, 120, 90), 2: (760, 120, 90), 3: (450, 60, 90)}  # left, top, side [px]
SHIFT_PX = 100  # between the eyes


def scene(margin_px, background, inverted=(), seed=0):
    """Both eyes with all four markers, frontal."""
    rng = np.random.default_rng(seed)
    grain = cv2.GaussianBlur(rng.normal(0.0, 60.0, (720, 1280)), (0, 0), 2.0)
    wall = np.clip(background + grain, 0, 255)
    eyes = []
    for shift in (0, SHIFT_PX):
        image = wall.copy()
        for number, (left, top, side) in PLACES.items():
            x = left + SHIFT_PX - shift
            printed = cv2.aruco.generateImageMarker(dictionary_by_name(MACHINE.dictionary), number, side)
            block = np.full((side + 2 * margin_px, side + 2 * margin_px), 220.0)
            block[margin_px : margin_px + side, margin_px : margin_px + side] = np.where(printed > 127, 220.0, 20.0)
            if number in inverted:
                block = 240.0 - block
            image[top - margin_px : top + side + margin_px, x - margin_px : x + side + margin_px] = block
        soft = cv2.GaussianBlur(image, (0, 0), 0.7) + rng.normal(0.0, 1.5, image.shape)
        eyes.append(np.clip(soft, 0, 255).astype(np.uint8))
    return eyes


def observed(eyes, pairs=12):
    source = ArucoPoseSource(MACHINE)
    return [source.observe(*eyes, k * 66_000_000) for k in range(pairs)][-1]


@pytest.mark.parametrize("background", [55.0, 70.0])
def test_a_print_without_a_white_margin_is_named_so_and_not_covered_or_blurred(background):
    seen = observed(scene(0, background))
    bare = [view for view in seen.marker_views if "no white margin" in view.reason]
    assert bare, [view.reason for view in seen.views]
    assert not any("covered" in view.reason for view in seen.marker_views)
    assert all("at least one cell of white" in view.reason for view in bare)


def test_a_print_without_a_white_margin_says_nothing_of_the_focus():
    left, right = (cv2.GaussianBlur(eye, (0, 0), 6.0) for eye in scene(24, 120.0))
    x, y, side = PLACES[10]
    corners = np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]], dtype=float)
    found = {}
    for reason in ("", f"marker 10 has {NO_WHITE_MARGIN_REASON}"):
        view = MarkerView(10, corners + np.array([SHIFT_PX, 0.0]), corners, 0.1, False, reason)
        pair = SimpleNamespace(
            frame=SimpleNamespace(left=left, right=right), observation=SimpleNamespace(marker_views=(view,))
        )
        found[reason] = len(BlurMonitor().at_markers(pair))
    assert list(found.values()) == [1, 0]


def test_with_a_margin_nothing_is_said():
    seen = observed(scene(24, 80.0))
    assert {view.marker_id for view in seen.marker_views} == set(PLACES)
    assert not any(
        word in view.reason for view in seen.marker_views for word in ("margin", "covered", "white on black")
    )


def test_a_cover_over_two_sides_stays_a_cover():
    eyes = scene(24, 120.0)
    for eye, x in zip(eyes, (SHIFT_PX, 0), strict=True):
        left, top, side = PLACES[10]
        eye[top + 60 : top + side + 60, left + x - 10 : left + x + 6] = 25
        eye[top + side - 8 : top + side + 60, left + x - 60 : left + x + side + 60] = 25
    reasons = [view.reason for view in observed(eyes).marker_views if view.marker_id == 10]
    assert all("no white margin" not in reason for reason in reasons), reasons


def test_white_on_black_is_named_and_black_on_white_is_measured_beside_it():
    seen = observed(scene(24, 120.0, inverted=(10,)))
    assert seen.tool.status is PoseStatus.NOT_SEEN
    assert "marker 10 is printed white on black; print it black on white" in seen.tool.reason
    assert "white on black" not in seen.ooi.reason
