"""Printed targets on tool and OOI: markers, and boards of markers."""

from dataclasses import dataclass
from typing import Literal

from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class Marker:
    """One square fiducial: id, printed side [m], what it sits on, and its pose there."""

    marker_id: int
    side_m: float
    on: Literal["tool", "ooi"]
    T_on_marker: Array


@dataclass(frozen=True, slots=True)
class Board:
    """Many markers on one plate. Geometry: `machine.boards`.

    "charuco": a chessboard of squares_x by squares_y squares of `square_m`, markers of `marker_m` in its white ones;
    the inner chess corners are what is measured. "grid": squares_x by squares_y markers at a pitch of `square_m`; they
    also stand in `Machine.markers`, one by one. Ids run row by row from the top left, from `first_id`.
    `T_on_board`: the board's middle, x right, y up, z out of the print.
    """

    kind: Literal["charuco", "grid"]
    on: Literal["tool", "ooi"]
    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float
    first_id: int
    legacy_pattern: bool  # white square at the top left where the number of rows is even
    T_on_board: Array
