"""Marker and board sections of a machine file: strict models, and the checks across them."""

import re
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from machine.errors import MachineFileError


class Strict(BaseModel):
    """A section in which every key is known and every number finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


Pose16 = Annotated[list[float], Field(min_length=16, max_length=16)]
Length = Annotated[float, Field(gt=0.0, le=2.0)]
Squares = Annotated[int, Field(ge=1, le=100)]

CHARUCO_SQUARES_MIN = 3  # along each side: fewer leave no four inner corners
MARKER_OF_SQUARE_MAX_FRAC = 0.9  # of the square; the white around a marker is what its sides are seen by
DICTIONARY_PATTERN = r"^DICT_([4-7]X[4-7]_(50|100|250|1000)|APRILTAG_[0-9]{2}[hH][0-9]{1,2}|ARUCO_[A-Za-z0-9_]+)$"
# How many ids the families have whose names do not say it; others with such names are left to the vision package.
MARKER_FAMILY_ID_COUNTS = {
    "DICT_APRILTAG_16H5": 30,
    "DICT_APRILTAG_25H9": 35,
    "DICT_APRILTAG_36H10": 2320,
    "DICT_APRILTAG_36H11": 587,
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_ARUCO_MIP_36H12": 250,
}
MARKER_FIELD_REMEDIES = {
    "dictionary": "give a name of OpenCV's, such as DICT_4X4_50 or DICT_APRILTAG_36h11",
    "id": "give the number printed next to the marker",
    "side_m": "measure the printed marker's black outer side and give it in metres",
    "on": "state what it is mounted on",
    "T_on_marker": "give 16 numbers row by row, metres in the last column, or measure them by `longreach target teach`",
    "T_on_board": "give 16 numbers row by row, metres in the last column, of the board's middle",
    "kind": "charuco is a chessboard with markers in its white squares, grid is markers only",
    "squares_x": "count the squares from left to right",
    "squares_y": "count the squares from top to bottom",
    "square_m": "measure ten squares of the print and divide",
    "marker_m": "measure the black outer side of one of the board's markers",
    "first_id": "give the lowest marker id on the board",
    "legacy_pattern": "true for boards made by OpenCV before 4.6 with an even number of rows",
}


class MarkerSection(Strict):
    """[[markers.marker]]."""

    id: Annotated[int, Field(ge=0)]
    side_m: Length
    on: Literal["tool", "ooi"]
    T_on_marker: Pose16


class BoardSection(Strict):
    """[[markers.board]]."""

    kind: Literal["charuco", "grid"]
    on: Literal["tool", "ooi"]
    squares_x: Squares
    squares_y: Squares
    square_m: Length
    marker_m: Length
    first_id: Annotated[int, Field(ge=0)]
    legacy_pattern: bool = False
    T_on_board: Pose16

    @property
    def marker_ids(self) -> range:
        """Ids of its markers: in every place of a grid, in the white half of a chessboard's squares."""
        places = self.squares_x * self.squares_y
        return range(self.first_id, self.first_id + (places if self.kind == "grid" else places // 2))


class MarkersSection(Strict):
    """[markers]: at least one marker or board on the tool and on the OOI."""

    dictionary: Annotated[str, Field(pattern=DICTIONARY_PATTERN)]
    marker: list[MarkerSection] = []
    board: list[BoardSection] = []

    @model_validator(mode="after")
    def _nothing_is_missing(self) -> Self:
        if not self.marker and not self.board:
            raise ValueError("neither marker nor board; give the tool and the ooi at least one [[markers.marker]] each")
        return self


def dictionary_size(name: str) -> int | None:
    """Number of ids in a dictionary; None where neither the name nor the table states it."""
    counted = re.fullmatch(r"DICT_[4-7]X[4-7]_(\d+)", name)
    return int(counted[1]) if counted else MARKER_FAMILY_ID_COUNTS.get(name.upper())


def check_markers(section: MarkersSection) -> None:
    """Refuse what `check_ids` refuses, and a tool or an OOI without a target.

    Raises: MachineFileError naming field, value, limit and remedy.
    """
    check_ids([marker.id for marker in section.marker], section.board, section.dictionary)
    for on in ("tool", "ooi"):
        if not any(part.on == on for part in (*section.marker, *section.board)):
            raise MachineFileError(f"markers.marker: none has on = {on!r}; give the {on} at least one marker")


def check_ids(ids: Sequence[int], boards: Sequence[BoardSection], dictionary: str) -> None:
    """Refuse repeated ids, ids that the dictionary does not have, and bad boards. `ids`: of the single markers.

    Raises: MachineFileError naming field, value, limit and remedy.
    """
    for k, board in enumerate(boards):
        _check_board(f"markers.board.{k}", board)
    if len(set(ids)) != len(ids):
        raise MachineFileError(f"markers.marker: ids {list(ids)} repeat; every marker needs an id of its own")
    _check_board_ids(boards, set(ids))
    size = dictionary_size(dictionary)
    if size is not None:
        _check_range(ids, boards, dictionary, size)


def _check_board(name: str, board: BoardSection) -> None:
    if board.kind == "charuco":
        for field, count in (("squares_x", board.squares_x), ("squares_y", board.squares_y)):
            if count < CHARUCO_SQUARES_MIN:
                raise MachineFileError(
                    f"{name}.{field} = {count} is below {CHARUCO_SQUARES_MIN} squares; a charuco board needs four "
                    "inner corners: print a larger one, or use kind = 'grid'"
                )
    elif board.legacy_pattern:
        raise MachineFileError(f"{name}.legacy_pattern = True is for kind = 'charuco' only; leave it out of a grid")
    limit = MARKER_OF_SQUARE_MAX_FRAC * board.square_m
    if board.marker_m > limit:
        raise MachineFileError(
            f"{name}.marker_m = {board.marker_m} exceeds {MARKER_OF_SQUARE_MAX_FRAC:g} of square_m, {limit:g} [m]; "
            "leave white around the markers, or measure both again"
        )


def _check_board_ids(boards: Sequence[BoardSection], taken: set[int]) -> None:
    for k, board in enumerate(boards):
        both = taken & set(board.marker_ids)
        if both:
            raise MachineFileError(
                f"markers.board.{k}.first_id = {board.first_id}: its ids {board.marker_ids[0]} .. "
                f"{board.marker_ids[-1]} repeat {sorted(both)[:4]} of another marker or board; "
                "every marker needs an id of its own"
            )
        taken = taken | set(board.marker_ids)


def _check_range(ids: Sequence[int], boards: Sequence[BoardSection], dictionary: str, size: int) -> None:
    for marker_id in ids:
        if marker_id >= size:
            raise MachineFileError(
                f"markers.marker: id = {marker_id} is not in {dictionary}, which ends at {size - 1}; "
                f"{MARKER_FIELD_REMEDIES['id']}, or a larger dictionary"
            )
    for k, board in enumerate(boards):
        if board.marker_ids[-1] >= size:
            raise MachineFileError(
                f"markers.board.{k}.first_id = {board.first_id}: its last id {board.marker_ids[-1]} is not in "
                f"{dictionary}, which ends at {size - 1}; give a lower first_id or a larger dictionary"
            )
