"""Printed boards: the cells of a chessboard, and edges that lie where they should."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from machine.description import Board, parse_machine_toml
from machine.poses import inverse_pose, pose
from machine.rotations import rotation_about
from sim_plc.camera import boards
from sim_plc.camera.eye import eye_rays

ROOT = Path(__file__).parents[3]
CAMERA = parse_machine_toml((ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")).camera
RAYS = eye_rays(CAMERA)


@pytest.mark.parametrize("share", [0.5, 0.6, 0.7, 0.75, 0.8, 0.9])
@pytest.mark.parametrize("name", ["DICT_4X4_50", "DICT_APRILTAG_36h11"])
def test_squares_and_modules_consist_of_whole_cells(share, name):
    target = Board("charuco", "ooi", 5, 4, 0.04, 0.04 * share, 2, False, np.eye(4))
    drawn = boards.chess_board(name, target, np.eye(4))
    per_square = round(0.04 / drawn.cell_x_m)
    half = per_square // 2
    inside = drawn.cell_greys[half:-half, half:-half]
    assert inside.shape == (4 * per_square, 5 * per_square)
    assert np.all(drawn.cell_greys[: half - 1] == boards.PAPER_GREY)
    assert np.all(inside[:per_square, :per_square] == boards.INK_GREY)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    large = cv2.resize(
        drawn.cell_greys, None, fx=600 / len(drawn.cell_greys), fy=600 / len(drawn.cell_greys), interpolation=0
    )
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(large)
    assert sorted(np.ravel(ids)) == list(range(2, 12))
    per_px = 600 / len(drawn.cell_greys) / drawn.cell_x_m
    sides = [np.linalg.norm(quad.reshape(4, 2)[1] - quad.reshape(4, 2)[0]) / per_px for quad in corners]
    assert np.mean(sides) == pytest.approx(0.04 * share, abs=0.0006)


@pytest.mark.parametrize("axis", [0, 1])
def test_an_edge_along_the_pixels_is_placed_to_a_fraction_of_a_pixel(axis):
    """Rays on a straight grid would know four places only."""
    flat = boards.Board(np.full((1, 1), 0, np.uint8), 0.2, 0.2, np.eye(4))
    errors = []
    for shift_px in np.linspace(0.0, 1.0, 41):
        move = np.zeros(3)
        move[axis] = 0.1 + shift_px / CAMERA.fx_px  # one edge near the principal point, at 1 m
        T_cam_board = pose(rotation_about("x", np.pi), np.append(move[:2], 1.0))
        image = np.full((CAMERA.height_px, CAMERA.width_px), 200, np.uint8)
        boards.paint_board(image, RAYS, flat, np.repeat(inverse_pose(T_cam_board)[None], 2, axis=0))
        line = image[355:365].mean(axis=0) if axis == 0 else image[:, 635:645].mean(axis=1)
        middle = round(CAMERA.cx_px if axis == 0 else CAMERA.cy_px)
        bright = line[middle - 20 : middle + 20].sum() / 200.0  # px to the left of the edge
        errors.append(bright - shift_px)
    errors = np.array(errors) - np.mean(errors)
    assert np.abs(errors).max() < 0.05, "px"
