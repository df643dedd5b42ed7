"""Contents of the printed pages: a marker or board at true size, a ruler, and instructions."""

import cv2
import numpy as np

from longreach.target_page import Page, Rectangle, Text
from machine.boards import board_marker_ids, dark_squares
from machine.description import Board, Marker

PAPERS_MM = {
    "a5": (148.0, 210.0),
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
}
RULER_MM = 100.0
MARGIN_MM = 8.0  # that printers cannot reach
FOOT_MM = 34.0  # ruler and words
TEXT_MM = 3.0


def marker_page(dictionary_name: str, dictionary: "cv2.aruco.Dictionary", marker: Marker, paper: str | None) -> Page:
    """One marker upright in the middle of a page.

    Raises: ValueError: it does not fit on the paper.
    """
    side = 1e3 * marker.side_m
    quiet = side / (dictionary.markerSize + 2)
    width, height = _paper_for(side + 2 * quiet, side + 2 * quiet, paper, f"marker {marker.marker_id}")
    left, top = 0.5 * (width - side), 0.5 * (height - FOOT_MM - side)
    words = (
        f"marker {marker.marker_id} of {dictionary_name}, on the {marker.on}: black side {side:g} mm",
        "print at 100 % (no scaling), check the ruler, keep the white around it, mount flat and stiff",
    )
    name = f"marker_{marker.marker_id}"
    shapes = (tuple(_marker_cells(dictionary, marker.marker_id, left, top, side)), tuple(_ruler(width, height)))
    return Page(name, width, height, shapes, _texts(words, height, left, top - quiet))


def board_page(dictionary_name: str, dictionary: "cv2.aruco.Dictionary", board: Board, paper: str | None) -> Page:
    """One board in the middle of a page.

    Raises: ValueError: it does not fit on the paper.
    """
    square, side = 1e3 * board.square_m, 1e3 * board.marker_m
    wide, high = square * board.squares_x, square * board.squares_y
    quiet = 0.5 * square if board.kind == "charuco" else 0.0  # a grid's squares are white round the markers already
    width, height = _paper_for(wide + quiet, high + quiet, paper, f"board of first_id {board.first_id}")
    left, top = 0.5 * (width - wide), 0.5 * (height - FOOT_MM - high)
    dark = dark_squares(board)
    shapes: list[tuple[Rectangle, ...]] = [
        (Rectangle(left + column * square, top + row * square, square, square),)
        for row, column in zip(*np.nonzero(dark), strict=True)
    ]
    gap = 0.5 * (square - side)
    for marker_id, row, column in zip(board_marker_ids(board), *np.nonzero(~dark), strict=True):
        x, y = left + column * square + gap, top + row * square + gap
        shapes.append(tuple(_marker_cells(dictionary, marker_id, x, y, side)))
    words = (
        f"{board.kind} board {board.squares_x} x {board.squares_y} of {dictionary_name}, first id {board.first_id}, on "
        f"the {board.on}: square {square:g} mm, marker {side:g} mm",
        "print at 100 % (no scaling), check the ruler, mount flat and stiff",
    )
    return Page(
        f"board_{board.first_id}",
        width,
        height,
        (*shapes, tuple(_ruler(width, height))),
        _texts(words, height, left, top - 0.5 * quiet),
    )


def _paper_for(wide_mm: float, high_mm: float, paper: str | None, what: str) -> tuple[float, float]:
    """The requested paper, or the smallest that holds it; portrait or landscape."""
    names = [paper] if paper else list(PAPERS_MM)
    for name in names:
        short, long = PAPERS_MM[name]
        for width, height in ((short, long), (long, short)):
            if wide_mm <= width - 2 * MARGIN_MM and high_mm <= height - FOOT_MM - MARGIN_MM:
                return width, height
    size = f"{wide_mm:.0f} x {high_mm:.0f} mm with its white"
    raise ValueError(f"{what} needs {size}, more than {names[-1]} paper holds; choose larger paper or a smaller side_m")


def _marker_cells(
    dictionary: "cv2.aruco.Dictionary", marker_id: int, left_mm: float, top_mm: float, side_mm: float
) -> list[Rectangle]:
    """Black cells of a marker, one rectangle for every run in a row."""
    n = int(dictionary.markerSize) + 2
    white = np.asarray(cv2.aruco.generateImageMarker(dictionary, marker_id, n)) > 127
    cell = side_mm / n
    cells = []
    for row in range(n):
        edges = np.flatnonzero(np.diff(np.concatenate([[True], white[row], [True]]).astype(int)))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            cells.append(Rectangle(left_mm + start * cell, top_mm + row * cell, (end - start) * cell, cell))
    return cells


def _ruler(width_mm: float, height_mm: float) -> list[Rectangle]:
    """100 mm with a tick every 10 mm, between the outer edges of the first and the last tick's middle lines."""
    left, base, line = 0.5 * (width_mm - RULER_MM), height_mm - MARGIN_MM - 6.0, 0.3
    ticks = [
        Rectangle(left + x - 0.5 * line, base - (5.0 if x % 50 == 0 else 3.0), line, 5.0 if x % 50 == 0 else 3.0)
        for x in range(0, int(RULER_MM) + 1, 10)
    ]
    return [*ticks, Rectangle(left - 0.5 * line, base, RULER_MM + line, line)]


def _texts(words: tuple[str, str], height_mm: float, left_mm: float, top_mm: float) -> tuple[Text, ...]:
    """The words at the foot, and which edge is the top, outside the white that the marker needs."""
    lines = tuple(
        Text(MARGIN_MM, height_mm - FOOT_MM + 5.0 + 5.0 * k, TEXT_MM * 0.8, line) for k, line in enumerate(words)
    )
    ruler = Text(MARGIN_MM, height_mm - MARGIN_MM + 1.0, TEXT_MM * 0.8, "the ruler must measure 100 mm")
    return (*lines, ruler, Text(left_mm, max(top_mm - 1.0, 4.0), TEXT_MM, "top"))
