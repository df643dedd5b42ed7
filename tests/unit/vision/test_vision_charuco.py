"""Chess corners: where they are to some hundredths of a pixel, and none where there is none."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_prints import photographed, printed
from vision_scenes import DATA, deviation, facing_pose, machine

from machine.boards import board_markers, inner_corners
from machine.camera import project_stereo
from machine.description import Board, StereoCamera
from machine.poses import pose, transform_points
from machine.rotations import rotation_about
from server.vision.charuco import board_corners, board_sighting, why_no_corner
from server.vision.contracts import PoseStatus
from server.vision.marker_search import dictionary_by_name, find_markers
from server.vision.object_pose import PoseSettings, estimate_object_pose

NAME = "DICT_5X5_100"
BOARD = Board("charuco", "ooi", 7, 5, 0.05, 0.0375, 5, False, np.eye(4))
PHOTOS = DATA / "markers" / "aruco_photos"


def found_in(image, name=NAME):
    return {one.marker_id: one.corners_px for one in find_markers(image, dictionary_by_name(name))}


def corners_in(images, board=BOARD, camera=None):
    lens = camera or machine().camera
    return [board_corners(image, board, found_in(image), lens) for image in images]


def truth_of(T, board=BOARD, camera=None):
    points = transform_points(T @ board.T_on_board, inner_corners(board))
    return project_stereo(camera or machine().camera, points)


def subpix(image, start, half):
    """OpenCV's search from the true places with the window that the markers leave."""
    points = np.ascontiguousarray(start, dtype=np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(image, points, (half, half), (-1, -1), (3, 40, 1e-3)).reshape(-1, 2)


@pytest.mark.parametrize(
    ("distance_m", "tilt_deg", "roll_deg"), [(0.5, 20, 30), (0.8, 0, 10), (1.2, 40, 80), (0.7, 15, 0)]
)
def test_corners_of_a_rendered_board(distance_m, tilt_deg, roll_deg):
    rng = np.random.default_rng(1)
    T = facing_pose(distance_m, tilt_deg, roll_deg, (0.1, -0.05))
    images = photographed(printed(NAME, BOARD), T, rng)
    ours, theirs = [], []
    for image, found, true in zip(images, corners_in(images), truth_of(T), strict=True):
        assert np.isfinite(found).all()
        ours.append(found - true)
        cell = np.linalg.norm(true[1] - true[0])
        theirs.append(subpix(image, true + rng.normal(0, 0.3, true.shape), max(2, round(0.125 * cell))) - true)
    errors = np.array(ours)
    assert np.sqrt(np.mean(errors**2)) < 0.025, "px rms"
    assert np.abs(errors).max() < 0.1, "px"
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.015, "px: half a pixel would show here"
    assert np.sqrt(np.mean(errors**2)) < 0.6 * np.sqrt(np.mean(np.array(theirs) ** 2)), "better than a round window"


@pytest.mark.parametrize("legacy", [False, True])
def test_corner_ids_and_places_are_those_of_opencv(legacy):
    board = replace(BOARD, squares_y=6, legacy_pattern=legacy, first_id=0)
    theirs = cv2.aruco.CharucoBoard((7, 6), 0.05, 0.0375, dictionary_by_name(NAME))
    theirs.setLegacyPattern(legacy)
    shift = np.array([0.5 * 7 * 0.05, 0.5 * 6 * 0.05, 0.0])
    flip = np.array([1.0, -1.0, 1.0])  # theirs starts at the top left, y down
    corners = np.asarray(theirs.getChessboardCorners()).reshape(-1, 3)
    assert np.allclose((corners - shift) * flip, inner_corners(board), atol=1e-7)
    first = np.array([np.asarray(one).reshape(4, 3).mean(axis=0) for one in theirs.getObjPoints()])
    ours = np.array([marker.T_on_marker[:3, 3] for marker in board_markers(board)])
    assert np.allclose((first - shift) * flip, ours, atol=1e-7)
    drawn = theirs.generateImage((700, 600), marginSize=0)
    shown = {one.marker_id: one.corners_px.mean(axis=0) for one in find_markers(drawn, dictionary_by_name(NAME))}
    for marker in board_markers(board):
        x, y = marker.T_on_marker[:2, 3] / 0.05
        assert np.abs(shown[marker.marker_id] - [100 * (x + 3.5) - 0.5, 100 * (3.0 - y) - 0.5]).max() < 1.0


def test_opencv_draws_a_board_and_we_find_its_corners_without_offset():
    theirs = cv2.aruco.CharucoBoard((7, 5), 0.05, 0.0375, dictionary_by_name(NAME))
    image = np.full((720, 1280), 255, np.uint8)
    image[100:600, 200:900] = theirs.generateImage((700, 500), marginSize=0)
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    flat = replace(machine().camera, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    found = board_corners(image, replace(BOARD, first_id=0), found_in(image), flat)
    row, column = np.divmod(np.arange(24), 6)
    expected = np.column_stack([200 + 100 * (column + 1) - 0.5, 100 + 100 * (row + 1) - 0.5])
    assert np.abs(found - expected).max() < 0.03, "px"


def test_the_board_gives_the_pose_of_what_it_sits_on():
    rng = np.random.default_rng(3)
    T_on_board = pose(rotation_about("y", 0.2), np.array([0.1, -0.05, 0.03]))
    board = replace(BOARD, T_on_board=T_on_board)
    T = facing_pose(0.8, 20.0, 15.0)
    images = photographed(printed(NAME, board), T, rng)
    sighting = board_sighting(board, images, (found_in(images[0]), found_in(images[1])), machine().camera)
    assert sighting is not None
    found, views = estimate_object_pose("ooi", (sighting,), machine().camera, PoseSettings())
    assert found.status is PoseStatus.OK
    assert views[0].marker_id == board.first_id
    apart = deviation(found.T_cam_object, T)
    assert np.rad2deg(np.linalg.norm(apart[:3])) < 0.05
    assert 1e3 * np.linalg.norm(apart[3:]) < 0.3


def test_covered_corners_are_left_out_and_the_others_stay():
    T = facing_pose(0.6, 15.0, 5.0)
    left, _ = photographed(printed(NAME, BOARD), T, np.random.default_rng(4))
    true = truth_of(T)[0]
    covered = left.copy()
    low, high = true[[0, 13]].min(axis=0).astype(int) - 15, true[[0, 13]].max(axis=0).astype(int) + 15
    cv2.ellipse(covered, (int(low[0] + high[0]) // 2, int(low[1] + high[1]) // 2), (80, 60), 20, 0, 360, 90, -1)
    found = board_corners(covered, BOARD, found_in(covered), machine().camera)
    seen = np.isfinite(found[:, 0])
    assert 10 <= seen.sum() < 24
    assert np.abs(found - true)[seen].max() < 0.1, "px"


def test_few_small_markers_never_give_a_corner_one_square_off():
    """Two markers of 11 px say little about the far end of the board: the corners grow from where they are known."""
    rng = np.random.default_rng(5)
    for _ in range(6):
        T = facing_pose(1.8, rng.uniform(0, 30), rng.uniform(-180, 180), tuple(rng.uniform(-0.3, 0.3, 2)))
        images = photographed(printed(NAME, BOARD), T, rng)
        for image, true in zip(images, truth_of(T), strict=True):
            some = dict(list(found_in(image).items())[:2])
            found = board_corners(image, BOARD, some, machine().camera)
            seen = np.isfinite(found[:, 0])
            assert not seen.any() or np.abs(found - true)[seen].max() < 0.3, "px"


def test_one_marker_is_enough_to_find_the_rest():
    T = facing_pose(0.6, 20.0, 40.0)
    left, _ = photographed(printed(NAME, BOARD), T, np.random.default_rng(6))
    one = dict(list(found_in(left).items())[7:8])
    found = board_corners(left, BOARD, one, machine().camera)
    assert np.isfinite(found).all()
    assert np.abs(found - truth_of(T)[0]).max() < 0.1, "px"


def test_a_board_described_wrongly_shows_no_corner_but_a_reason():
    """White and black swapped: its markers are where they should be, its squares are not."""
    even = replace(BOARD, squares_y=6)
    T = facing_pose(0.7, 10.0, 0.0)
    left, _ = photographed(printed(NAME, even), T, np.random.default_rng(7))
    found = board_corners(left, replace(even, legacy_pattern=True), found_in(left), machine().camera)
    assert np.isnan(found).all()
    assert "legacy_pattern" in why_no_corner(even, found_in(left))
    assert why_no_corner(even, {}) == ""


@pytest.mark.parametrize("seed", range(4))
def test_a_picture_without_board_shows_no_corner(seed):
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(rng.integers(0, 255, (720, 1280)).astype(np.uint8), (0, 0), 2.0)
    assert np.isnan(board_corners(image, BOARD, {}, machine().camera)).all()
    square = np.array([[300.0, 300.0], [360.0, 300.0], [360.0, 360.0], [300.0, 360.0]])
    assert np.isnan(board_corners(image, BOARD, {5: square, 6: square + 100.0}, machine().camera)).all()


def test_photographs_of_a_board_whole_and_behind_a_hand():
    if not PHOTOS.is_dir():
        pytest.skip(f"no photographs in {PHOTOS}")
    board = Board("charuco", "ooi", 5, 7, 0.04, 0.02, 0, False, np.eye(4))
    counts = {}
    for name in ("unobscured", "obscured"):
        image = cv2.imread(str(PHOTOS / f"charuco_{name}.jpg"), cv2.IMREAD_GRAYSCALE)
        height, width = image.shape
        camera = StereoCamera(
            width, height, 800.0, 800.0, (width - 1) / 2, (height - 1) / 2, (0.0,) * 5, 0.1, 30.0, True
        )
        found = board_corners(image, board, found_in(image, "DICT_6X6_250"), camera)
        seen = np.isfinite(found[:, 0])
        counts[name] = int(seen.sum())
        H, _ = cv2.findHomography(inner_corners(board)[seen, :2] * 1e3, found[seen])
        flat = np.column_stack([inner_corners(board)[seen, :2] * 1e3, np.ones(seen.sum())]) @ H.T
        residual = flat[:, :2] / flat[:, 2:] - found[seen]
        assert np.sqrt(np.mean(residual**2)) < 0.3, "px rms off one plane; webcam lens not calibrated"
        there = subpix(image, found[seen], 6)
        assert np.linalg.norm(there - found[seen], axis=1).max() < 0.5, "px from OpenCV's saddle: corners are corners"
    assert counts["unobscured"] == 24
    assert 14 <= counts["obscured"] <= 21, "the hand lies over the lower rows"
