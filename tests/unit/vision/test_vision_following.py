"""Markers followed from pair to pair: the code is read again each time, and what cannot be followed is searched."""

import cv2
import numpy as np
import pytest
from vision_scenes import machine, renderer, tcp_in_ooi

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.vision.detection import EyeDetector, MarkerFollower
from server.vision.marker_search import (
    NO_MATCH,
    dictionary_by_name,
    find_markers,
    marker_cells,
    refined_marker,
    wrong_cells,
)
from sim_plc.camera.renderer import StaticPose

WANTED = frozenset({1, 3, 10})  # 2 hides behind the tool here


@pytest.fixture(scope="module")
def dictionary():
    return dictionary_by_name(machine().dictionary)


def left_eye(distance_m: float, shift_m: float = 0.0, turn_rad: float = 0.0):
    T = tcp_in_ooi(distance_m) @ pose(rotation_from_rotvec(np.array([0.0, 0.0, turn_rad])), np.array([shift_m, 0, 0]))
    return renderer().render(StaticPose(T), 0, np.random.default_rng(1))[0]


def printed(dictionary, marker_id: int, cell_px: int = 9, grey: tuple[int, int] = (20, 230)):
    cells = marker_cells(dictionary, marker_id).astype(np.uint8)
    marker = np.kron(cells, np.ones((cell_px, cell_px), np.uint8)) * (grey[1] - grey[0]) + grey[0]
    image = np.pad(marker, 20, constant_values=grey[1]).astype(np.uint8)
    low, high = 19.5, 19.5 + len(marker)
    return image, np.array([[low, low], [high, low], [high, high], [low, high]])


@pytest.mark.parametrize("marker_id", [0, 7, 23, 49])
def test_the_cells_of_a_printed_marker_all_agree_and_no_other_id_does(dictionary, marker_id):
    image, corners = printed(dictionary, marker_id)
    counts = [wrong_cells(image, corners, marker_cells(dictionary, other)) for other in range(50)]
    assert counts[marker_id] == 0
    assert sorted(counts)[1] >= 3


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_a_turned_marker_does_not_agree(dictionary, quarter):
    image, corners = printed(dictionary, 7)
    turned = np.ascontiguousarray(np.roll(corners, quarter, axis=0))
    assert wrong_cells(image, turned, marker_cells(dictionary, 7)) > 0


def test_no_contrast_and_leaving_the_picture_are_no_match(dictionary):
    image, corners = printed(dictionary, 7, grey=(100, 106))
    assert wrong_cells(image, corners, marker_cells(dictionary, 7)) == NO_MATCH
    image, corners = printed(dictionary, 7)
    assert wrong_cells(image, corners + 40.0, marker_cells(dictionary, 7)) == NO_MATCH
    assert wrong_cells(image, np.zeros((4, 2)), marker_cells(dictionary, 7)) == NO_MATCH
    assert wrong_cells(image, np.full((4, 2), np.nan), marker_cells(dictionary, 7)) == NO_MATCH


def test_a_marker_is_followed_through_motion_with_the_corners_a_search_finds(dictionary):
    follower = MarkerFollower(machine().camera, dictionary)
    for step in range(4):
        image = left_eye(0.6, shift_m=0.0025 * step, turn_rad=0.002 * step)
        searched = {
            one.marker_id: refined_marker(one, image, dictionary, machine().camera)
            for one in find_markers(image, dictionary)
            if one.marker_id in WANTED
        }
        if step:
            for marker_id in sorted(WANTED):
                followed = follower.follow_marker(marker_id, image)
                assert followed is not None
                assert np.abs(followed.corners_px - searched[marker_id].corners_px).max() < 0.03
        follower.store_marker_positions(searched)


def test_another_marker_in_the_same_place_is_not_followed(dictionary):
    follower = MarkerFollower(machine().camera, dictionary)
    image, _ = printed(dictionary, 7)
    found = {one.marker_id: refined_marker(one, image, dictionary, None) for one in find_markers(image, dictionary)}
    follower.store_marker_positions(found)
    assert follower.follow_marker(7, image) is not None
    other, _ = printed(dictionary, 8)
    assert follower.follow_marker(7, other) is None
    blank = np.full_like(image, 230)
    assert follower.follow_marker(7, blank) is None


def test_while_all_is_followed_a_second_one_of_the_same_id_is_found_at_half_size():
    image = left_eye(0.6)
    detector = EyeDetector(machine().camera, machine().dictionary, WANTED)
    assert detector.detect(image).markers.keys() == WANTED
    corners = detector.detect(image).markers[1]
    low, high = corners.min(axis=0).astype(int) - 12, corners.max(axis=0).astype(int) + 12
    patch = image[low[1] : high[1], low[0] : high[0]]
    doubled = image.copy()
    doubled[10 : 10 + patch.shape[0], 10 : 10 + patch.shape[1]] = patch
    pairs = next(k for k in range(1, 14) if detector.detect(doubled).repeated_ids == {1})
    assert pairs <= 12
    assert 1 not in detector.detect(doubled).markers


def test_both_eyes_do_not_search_the_whole_picture_in_the_same_pair():
    image = left_eye(0.6)
    first, second = (EyeDetector(machine().camera, machine().dictionary, WANTED, phase=phase) for phase in (0, 1))
    searches = [(first.detect(image).full_search, second.detect(image).full_search) for _ in range(40)]
    assert searches[0] == (True, True), "nothing is known yet"
    assert not any(all(both) for both in searches[1:])
    assert 2 <= sum(one for one, _ in searches[1:]) <= 4


def test_an_empty_picture_is_searched_at_once_then_every_third():
    detector = EyeDetector(machine().camera, machine().dictionary, WANTED)
    blank = np.full((720, 1280), 128, np.uint8)
    searches = [detector.detect(blank).full_search for _ in range(12)]
    assert searches[:3] == [True, True, True]
    assert sum(searches[3:]) in (2, 3)
    assert cv2.countNonZero(blank) > 0


def test_a_picture_that_has_become_smaller_than_the_last_places_shows_nothing():
    """A camera that falls back to another size: the places of the last pair lie outside."""
    detector = EyeDetector(machine().camera, machine().dictionary, WANTED)
    image = left_eye(0.6)
    assert detector.detect(image).markers
    small = np.ascontiguousarray(image[:40, :60])
    assert detector.detect(small).markers == {}
    assert detector.detect(np.ascontiguousarray(image[:, :5])).markers == {}
