"""A bolt plate with raised blocks, as boards of fine grey cells, and its look-alikes: objects that can be taught."""

from dataclasses import replace

import cv2
import numpy as np

from machine.poses import pose
from machine.rotations import rotation_about
from sim_plc.camera.boards import Board
from sim_plc.camera.texture import Grey, value_noise
from sim_plc.world import FixtureTruth

FIXTURE_CELL_SIZE_M = 0.001
BOLT_PLATE_SIZE_M = (0.46, 0.36)  # width, height
BLOCK_M, BLOCKS, BLOCK_HEIGHTS_M = (0.09, 0.07), 4, (0.02, 0.05)
BOLTS, BOLT_M = (4, 3), 0.013  # across and down, radius of a bolt's head
BOLT_OFFSET_MAX_M = 0.012  # by which a bolt of the same kind of plate may sit elsewhere
SPLASHES_PER_M2, SCRATCHES_PER_M2 = 6e3, 4e2
COVER_SHEET_HEIGHT_M = 0.07
STEEL_GREY, RUST_GREY = 125.0, 30.0
BOLT_ROW_SHIFT_M = 0.015
SCALED_FIXTURE_FACTOR = 1.03


def fixture_boards(fixture: FixtureTruth) -> tuple[Board, ...]:
    """The plate and its blocks in OOI axes; fixture axes: x right, y up, z out of the plate, origin in its middle.

    Variants: `taught` itself; `other`: the same kind, its bolts, blocks and rust elsewhere; `scaled`: 3 % larger in all
    directions; `row`: one row of bolts and the rust about it moved by 15 mm, the rest the same.
    """
    rng = np.random.default_rng([fixture.seed, fixture.variant == "other"])
    face = _plate_front_image(rng, fixture.variant == "row")
    scale = SCALED_FIXTURE_FACTOR if fixture.variant == "scaled" else 1.0
    boards = [_board_from_cells(face, pose(np.eye(3), np.zeros(3)))]
    for corner in range(BLOCKS):
        sides = np.array([1.0 if corner % 2 else -1.0, 1.0 if corner < 2 else -1.0])
        place = sides * rng.uniform((0.06, 0.05), (0.16, 0.12))
        height = float(rng.uniform(*BLOCK_HEIGHTS_M))
        turn = rotation_about("z", np.deg2rad(rng.uniform(-25.0, 25.0)))
        top = _painted_steel_image(rng, BLOCK_M)
        _draw_stencil_text(top, str(rng.integers(10, 100)), 1.2)
        boards.append(_board_from_cells(top, pose(turn, np.array([*place, height]))))
    if fixture.cover_frac > 0.0:
        boards.append(_cover_sheet_board(fixture))
    return tuple(_place_and_scale_board(board, fixture, scale) for board in boards)


def _cover_sheet_board(fixture: FixtureTruth) -> Board:
    """A dirty sheet over a share of the plate, from its left or right edge."""
    rng = np.random.default_rng([fixture.seed, 0x7368656574])
    width_m = fixture.cover_frac * BOLT_PLATE_SIZE_M[0]
    side = float(rng.choice([-1.0, 1.0]))
    cells = _painted_steel_image(rng, (width_m, 1.1 * BOLT_PLATE_SIZE_M[1]))
    return _board_from_cells(
        cells, pose(np.eye(3), np.array([side * 0.5 * (BOLT_PLATE_SIZE_M[0] - width_m), 0.0, COVER_SHEET_HEIGHT_M]))
    )


def _place_and_scale_board(board: Board, fixture: FixtureTruth, scale: float) -> Board:
    T = board.T_object_board.copy()
    T[:3, 3] *= scale
    cell_m = scale * board.cell_x_m
    return replace(board, cell_x_m=cell_m, cell_y_m=cell_m, T_object_board=fixture.T_ooi_fixture @ T)


def _board_from_cells(cells: Grey, T_fixture_board: np.ndarray) -> Board:
    return Board(cells, FIXTURE_CELL_SIZE_M, FIXTURE_CELL_SIZE_M, T_fixture_board)


def _painted_steel_image(rng: np.random.Generator, size_m: tuple[float, float]) -> Grey:
    """Painted steel with rust, dirt splashes and scratches."""
    cols, rows = round(size_m[0] / FIXTURE_CELL_SIZE_M), round(size_m[1] / FIXTURE_CELL_SIZE_M)
    side = max(cols, rows)
    grey = STEEL_GREY + 10.0 * value_noise(rng, side, side, side // 20, side // 20)
    rust = value_noise(rng, side, side, side // 9, side // 9)
    grey -= RUST_GREY * np.clip(rust - 0.6, 0.0, 1.0)
    out = np.clip(grey[:rows, :cols], 5, 250).astype(np.uint8)
    for _ in range(round(SPLASHES_PER_M2 * size_m[0] * size_m[1])):
        tone, radius = int(rng.choice([70, 95, 165])), int(rng.integers(1, 4))
        cv2.circle(out, _round_to_pixel(rng.uniform((0, 0), (cols, rows))), radius, tone, -1, cv2.LINE_AA)
    for _ in range(round(SCRATCHES_PER_M2 * size_m[0] * size_m[1])):
        start, step = rng.uniform((0, 0), (cols, rows)), rng.normal(0.0, 0.08 * side, 2)
        tone = int(rng.choice([60, 190]))
        cv2.line(out, _round_to_pixel(start), _round_to_pixel(start + step), tone, 1, cv2.LINE_AA)
    return np.ascontiguousarray(out)


def _plate_front_image(rng: np.random.Generator, row_moved: bool) -> Grey:
    """The plate's front: paint, bolts on an uneven grid, and a stencilled number."""
    face = _painted_steel_image(rng, BOLT_PLATE_SIZE_M)
    rows, cols = face.shape
    _draw_stencil_text(face, f"LR-{rng.integers(100, 1000)}", 1.6)
    spread = np.array([0.40, 0.30]) / (np.array(BOLTS) - 1)
    for j in range(BOLTS[1]):
        for i in range(BOLTS[0]):
            place = (np.array([i, j]) * spread - [0.20, 0.15]) + rng.uniform(-BOLT_OFFSET_MAX_M, BOLT_OFFSET_MAX_M, 2)
            _draw_bolt(face, np.array([0.5 * cols, 0.5 * rows]) + place / FIXTURE_CELL_SIZE_M, rng)
    if row_moved:
        top, height = 0, rows // 3
        shift = np.array([[1.0, 0.0, BOLT_ROW_SHIFT_M / FIXTURE_CELL_SIZE_M], [0.0, 1.0, 0.0]], np.float32)
        band = cv2.warpAffine(face[top : top + height], shift, (cols, height), borderMode=cv2.BORDER_WRAP)
        face[top : top + height] = band
    return face


def _draw_bolt(face: Grey, middle: np.ndarray, rng: np.random.Generator) -> None:
    """A hexagon head on its washer."""
    radius = BOLT_M / FIXTURE_CELL_SIZE_M
    cv2.circle(face, _round_to_pixel(middle), round(1.35 * radius), 165, -1, cv2.LINE_AA)
    angles = rng.uniform(0.0, np.pi / 3.0) + np.arange(6) * np.pi / 3.0
    corners = middle + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    cv2.fillPoly(face, [np.round(corners).astype(np.int32)], 55, cv2.LINE_AA)
    cv2.circle(face, _round_to_pixel(middle + 0.2 * radius), round(0.3 * radius), 110, -1, cv2.LINE_AA)


def _draw_stencil_text(face: Grey, text: str, scale: float) -> None:
    place = round(0.3 * face.shape[1]), round(0.6 * face.shape[0])
    cv2.putText(face, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 225, round(2 * scale), cv2.LINE_AA)


def _round_to_pixel(place: np.ndarray) -> tuple[int, int]:
    return round(float(place[0])), round(float(place[1]))
