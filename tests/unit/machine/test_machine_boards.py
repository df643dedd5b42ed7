"""Boards in the machine file, and where their corners and markers lie."""

import re
from dataclasses import replace

import numpy as np
import pytest
from machine_cases import MACHINE, TEXT

from machine.boards import board_marker_ids, board_markers, dark_first, dark_squares, inner_corners
from machine.description import Board, parse_machine_toml
from machine.errors import MachineError, MachineFileError
from machine.markers import object_corners
from machine.poses import pose
from machine.rotations import rotation_about

EYE = "[1.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.2, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]"
BOARD = f"""
[[markers.board]]
kind = "charuco"
on = "ooi"
squares_x = 5
squares_y = 4
square_m = 0.04
marker_m = 0.03
first_id = 20
legacy_pattern = false
T_on_board = {EYE}
"""
WITH_BOARD = TEXT.replace("\n[plc]", BOARD + "\n[plc]")


def test_a_file_without_boards_has_none():
    assert MACHINE.boards == ()
    assert MACHINE.boards_on("ooi") == ()


def test_a_charuco_board_is_read():
    machine = parse_machine_toml(WITH_BOARD)
    (board,) = machine.boards_on("ooi")
    assert (board.squares_x, board.squares_y, board.square_m, board.marker_m) == (5, 4, 0.04, 0.03)
    assert board.T_on_board[:2, 3].tolist() == [0.1, 0.2]
    assert [one.marker_id for one in machine.markers] == [10, 1, 2, 3]  # its own markers only lead to it
    with pytest.raises(ValueError, match="read-only"):
        board.T_on_board[0, 0] = 2.0


def test_the_markers_of_a_grid_are_markers_like_all_others():
    machine = parse_machine_toml(WITH_BOARD.replace('"charuco"', '"grid"'))
    assert len(machine.markers) == len(MACHINE.markers) + 20
    corners = object_corners(machine.markers_on("ooi"))
    assert sorted(corners)[-20:] == list(range(20, 40))
    assert np.allclose(corners[20].mean(axis=0), [0.1 - 2 * 0.04, 0.2 + 1.5 * 0.04, 0.0])
    assert np.allclose(corners[21].mean(axis=0) - corners[20].mean(axis=0), [0.04, 0.0, 0.0])
    assert np.allclose(corners[25].mean(axis=0) - corners[20].mean(axis=0), [0.0, -0.04, 0.0])
    assert np.linalg.norm(corners[20][1] - corners[20][0]) == pytest.approx(0.03)


def test_corners_run_row_by_row_from_the_top_left():
    board = Board("charuco", "ooi", 5, 4, 0.04, 0.03, 7, False, np.eye(4))
    corners = inner_corners(board)
    assert corners.shape == (12, 3)
    assert np.allclose(corners[0], [-0.06, 0.04, 0.0])
    assert np.allclose(corners[1] - corners[0], [0.04, 0.0, 0.0])
    assert np.allclose(corners[4] - corners[0], [0.0, -0.04, 0.0])
    assert np.allclose(corners.mean(axis=0), 0.0)
    assert dark_first(board).reshape(3, 4)[0].tolist() == [True, False, True, False]
    legacy = replace(board, legacy_pattern=True)
    assert dark_first(legacy).reshape(3, 4)[0].tolist() == [False, True, False, True]
    assert (dark_squares(replace(legacy, squares_y=5)) == dark_squares(replace(board, squares_y=5))).all()


def test_markers_sit_in_the_white_squares_of_the_board_where_it_hangs():
    T = pose(rotation_about("z", 0.3), np.array([0.1, 0.2, 0.3]))
    board = Board("charuco", "tool", 5, 4, 0.04, 0.03, 7, False, T)
    markers = board_markers(board)
    assert [marker.marker_id for marker in markers] == list(board_marker_ids(board)) == list(range(7, 17))
    assert {marker.on for marker in markers} == {"tool"}
    assert np.allclose(markers[0].T_on_marker, T @ pose(np.eye(3), np.array([-0.04, 0.06, 0.0])))
    assert all(marker.side_m == 0.03 for marker in markers)


def test_a_grid_has_no_chess_corners():
    board = Board("grid", "ooi", 2, 2, 0.04, 0.03, 7, False, np.eye(4))
    assert board_marker_ids(board) == (7, 8, 9, 10)
    for ask in (inner_corners, dark_first):
        with pytest.raises(MachineError, match="use its markers"):
            ask(board)


WRONG = [
    ('kind = "charuco"', 'kind = "chess"', "markers.board.0.kind = 'chess': Input should be 'charuco' or 'grid'"),
    (
        'on = "ooi"\nsquares',
        'on = "wall"\nsquares',
        "markers.board.0.on = 'wall': Input should be 'tool' or 'ooi'; state",
    ),
    ("squares_x = 5", "squares_x = 2", "markers.board.0.squares_x = 2 is below 3 squares"),
    (
        "squares_y = 4",
        "squares_y = 0",
        "markers.board.0.squares_y = 0: Input should be greater than or equal to 1; count",
    ),
    ("squares_y = 4", "squares_y = 101", "markers.board.0.squares_y = 101: Input should be less than or equal to 100"),
    ("square_m = 0.04", "square_m = 40.0", "square_m = 40.0: Input should be less than or equal to 2 [m]; measure ten"),
    ("marker_m = 0.03", "marker_m = 0.0", "marker_m = 0.0: Input should be greater than 0 [m]; measure the black"),
    (
        "marker_m = 0.03",
        "marker_m = 0.039",
        "markers.board.0.marker_m = 0.039 exceeds 0.9 of square_m, 0.036 [m]; leave",
    ),
    ("first_id = 20", "first_id = 45", "first_id = 45: its last id 54 is not in DICT_4X4_50, which ends at 49"),
    ("first_id = 20", "first_id = 1", "first_id = 1: its ids 1 .. 10 repeat [1, 2, 3, 10] of another"),
    ("first_id = 20", "first_id = -1", "first_id = -1: Input should be greater than or equal to 0; give the lowest"),
    ("legacy_pattern = false", "legacy_pattern = 1", "legacy_pattern = 1: Input should be a valid boolean; true for"),
    (f"T_on_board = {EYE}", "T_on_board = [1.0]", "T_on_board = [1.0]: List should have at least 16"),
    ("0.0, 0.1, 0.0, 1.0", "0.0, 0.1, 0.0, 2.0", "board of first_id 20: T_on_board is not a pose"),
    ("0.0, 0.1, 0.0, 1.0", "0.0, 100.0, 0.0, 1.0", "T_on_board lies 100 from the origin (limit 20 [m]); give metres"),
    ("square_m = 0.04\n", "", "markers.board.0.square_m: Field required [m]; measure ten squares"),
    ("first_id = 20", "first_id = 20\ncells = 3", "markers.board.0.cells = 3: Extra inputs are not permitted"),
]


@pytest.mark.parametrize(("old", "new", "expected"), WRONG)
def test_a_wrong_board_names_field_value_limit_and_remedy(old, new, expected):
    assert old in BOARD
    text = TEXT.replace("\n[plc]", BOARD.replace(old, new, 1) + "\n[plc]")
    with pytest.raises(MachineFileError, match=re.escape(expected)):
        parse_machine_toml(text)


def test_a_grid_has_no_legacy_pattern_and_two_boards_no_common_ids():
    grid = BOARD.replace('"charuco"', '"grid"')
    with pytest.raises(MachineFileError, match=r"legacy_pattern = True is for kind = 'charuco' only"):
        parse_machine_toml(TEXT.replace("\n[plc]", grid.replace("= false", "= true") + "\n[plc]"))
    two = BOARD + BOARD.replace("first_id = 20", "first_id = 29")
    with pytest.raises(MachineFileError, match=r"markers\.board\.1\.first_id = 29: its ids 29 \.\. 38 repeat \[29\]"):
        parse_machine_toml(TEXT.replace("\n[plc]", two + "\n[plc]"))


def test_a_board_alone_is_a_target():
    tool_only = TEXT[: TEXT.index("# The OOI's three markers")] + BOARD + TEXT[TEXT.index("[plc]") :]
    machine = parse_machine_toml(tool_only)
    assert machine.markers_on("ooi") == ()
    assert len(machine.boards_on("ooi")) == 1
    nothing = TEXT[: TEXT.index("[[markers.marker]]")] + TEXT[TEXT.index("[plc]") :]
    with pytest.raises(MachineFileError, match=r"markers: neither marker nor board; give the tool"):
        parse_machine_toml(nothing)


@pytest.mark.parametrize(
    "name", ["DICT_APRILTAG_36h11", "DICT_APRILTAG_16H5", "DICT_ARUCO_ORIGINAL", "DICT_ARUCO_MIP_36h12"]
)
def test_every_family_can_be_named(name):
    assert parse_machine_toml(TEXT.replace("DICT_4X4_50", name)).dictionary == name


def test_an_id_beyond_an_apriltag_family_is_refused():
    text = TEXT.replace("DICT_4X4_50", "DICT_APRILTAG_16h5").replace("id = 3\n", "id = 30\n")
    with pytest.raises(
        MachineFileError, match="id = 30 is not in DICT_APRILTAG_16h5, which ends at 29; give the number"
    ):
        parse_machine_toml(text)
