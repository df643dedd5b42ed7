"""Chess corners and markers of a board: origin at its middle, x right, y up, z out of the print."""

import numpy as np
from numpy.typing import NDArray

from machine.errors import MachineError
from machine.poses import pose
from machine.rotations import Array
from machine.targets import Board, Marker


def inner_corners(board: Board) -> Array:
    """Inner chess corners (n, 3) [m] of a charuco board, row by row from the top left, n = (squares_x-1)(squares_y-1).

    Raises: MachineError: a grid has none.
    """
    _require_chess(board)
    columns, rows = np.arange(1, board.squares_x), np.arange(1, board.squares_y)
    x, y = np.meshgrid(columns - 0.5 * board.squares_x, 0.5 * board.squares_y - rows)
    corners = np.zeros((x.size, 3))
    corners[:, 0], corners[:, 1] = board.square_m * x.ravel(), board.square_m * y.ravel()
    return corners


def dark_first(board: Board) -> NDArray[np.bool_]:
    """Whether the square up and left of each inner corner is black (n,), in the order of `inner_corners`.

    Raises: MachineError: a grid has no squares.
    """
    _require_chess(board)
    return dark_squares(board)[:-1, :-1].ravel()


def dark_squares(board: Board) -> NDArray[np.bool_]:
    """Which squares are black (squares_y, squares_x), row 0 at the top; the others hold a marker each."""
    row, column = np.mgrid[0 : board.squares_y, 0 : board.squares_x]
    if board.kind == "grid":
        return np.zeros(row.shape, dtype=bool)
    white_first = board.legacy_pattern and board.squares_y % 2 == 0  # OpenCV before 4.6
    return (row + column) % 2 == (1 if white_first else 0)


def board_marker_ids(board: Board) -> tuple[int, ...]:
    """Ids of the board's markers, row by row from the top left."""
    return tuple(range(board.first_id, board.first_id + int((~dark_squares(board)).sum())))


def board_markers(board: Board) -> tuple[Marker, ...]:
    """The board's markers with their places on the object that the board sits on."""
    row, column = np.nonzero(~dark_squares(board))
    x = (column + 0.5 - 0.5 * board.squares_x) * board.square_m
    y = (0.5 * board.squares_y - row - 0.5) * board.square_m
    return tuple(
        Marker(marker_id, board.marker_m, board.on, _marker_pose_on_object(board, float(u), float(v)))
        for marker_id, u, v in zip(board_marker_ids(board), x, y, strict=True)
    )


def _marker_pose_on_object(board: Board, x_m: float, y_m: float) -> Array:
    T_on_marker = board.T_on_board @ pose(np.eye(3), np.array([x_m, y_m, 0.0]))
    T_on_marker.setflags(write=False)
    return T_on_marker


def _require_chess(board: Board) -> None:
    if board.kind != "charuco":
        raise MachineError(
            f"board of first_id {board.first_id} is a {board.kind}: it has no chess corners; use its markers"
        )
