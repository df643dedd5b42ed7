"""Pages to print: black rectangles and text in millimetres, written as SVG, PDF or PNG that say their own size."""

import struct
import zlib
from dataclasses import dataclass, field
from html import escape

import cv2
import numpy as np

from machine.boards import board_marker_ids, dark_squares
from machine.description import Board, Marker
from server.vision.contracts import Image

POINTS_PER_MM = 72.0 / 25.4
HERSHEY_HEIGHT_PX = 21.0  # of a capital letter at scale 1


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A black rectangle: left and top edge from the page's top left corner, size [mm]."""

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float


@dataclass(frozen=True, slots=True)
class Text:
    """A line of text: start of its base line from the page's top left corner, height of capitals [mm]."""

    x_mm: float
    y_mm: float
    height_mm: float
    text: str


@dataclass(frozen=True, slots=True)
class Page:
    """One page. Each group of rectangles is filled as one shape, so that no hair lines show between neighbours."""

    name: str
    width_mm: float
    height_mm: float
    shapes: tuple[tuple[Rectangle, ...], ...]
    texts: tuple[Text, ...] = field(default=())


def svg_of(page: Page) -> bytes:
    """The page as SVG with its size in millimetres."""
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page.width_mm:g}mm" height="{page.height_mm:g}mm" '
        f'viewBox="0 0 {page.width_mm:g} {page.height_mm:g}">',
        f'<rect width="{page.width_mm:g}" height="{page.height_mm:g}" fill="white"/>',
    ]
    for shape in page.shapes:
        path = "".join(
            f"M{box.x_mm:.6g} {box.y_mm:.6g}h{box.width_mm:.6g}v{box.height_mm:.6g}h{-box.width_mm:.6g}z"
            for box in shape
        )
        parts.append(f'<path d="{path}" fill="black"/>')
    for label in page.texts:
        parts.append(
            f'<text x="{label.x_mm:g}" y="{label.y_mm:g}" font-family="Helvetica, Arial, sans-serif" '
            f'font-size="{label.height_mm / 0.72:.3g}">{escape(label.text)}</text>'
        )
    return "\n".join([*parts, "</svg>", ""]).encode()


def pdf_of(pages: list[Page]) -> bytes:
    """The pages as one PDF with their true size."""
    objects: list[bytes] = [b"", b"", b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"]
    kids = []
    for page in pages:
        content = _pdf_content(page)
        size = f"{page.width_mm * POINTS_PER_MM:.3f} {page.height_mm * POINTS_PER_MM:.3f}"
        kids.append(f"{len(objects) + 1} 0 R")
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents {len(objects) + 2} 0 R "
            "/Resources << /Font << /F1 3 0 R >> >> >>".encode()
        )
        objects.append(b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content))
    # PrintScaling None: viewers then propose 100 % instead of "fit to page"
    objects[0] = b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>"
    objects[1] = f"<< /Type /Pages /Count {len(pages)} /Kids [{' '.join(kids)}] >>".encode()
    return _pdf_file(objects)


def _pdf_content(page: Page) -> bytes:
    k, height = POINTS_PER_MM, page.height_mm
    lines = ["0 g"]
    for shape in page.shapes:
        lines += [
            f"{box.x_mm * k:.5f} {(height - box.y_mm - box.height_mm) * k:.5f} {box.width_mm * k:.5f} "
            f"{box.height_mm * k:.5f} re"
            for box in shape
        ]
        lines.append("f")
    for label in page.texts:
        text = label.text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
        x, y = label.x_mm * k, (height - label.y_mm) * k
        lines.append(f"BT /F1 {label.height_mm * k / 0.72:.3f} Tf {x:.3f} {y:.3f} Td ({text}) Tj ET")
    return "\n".join(lines).encode("latin-1", "replace")


def _pdf_file(objects: list[bytes]) -> bytes:
    out = bytearray(b"%PDF-1.4\n")
    places = []
    for number, content in enumerate(objects, 1):
        places.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, content)
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table)
    return bytes(out)


def raster_of(page: Page, dpi: int) -> Image:
    """The page as a grey picture; edges to the nearest pixel."""
    k = dpi / 25.4
    image = np.full((round(page.height_mm * k), round(page.width_mm * k)), 255, np.uint8)
    for box in (box for shape in page.shapes for box in shape):
        left, top = round(box.x_mm * k), round(box.y_mm * k)
        right, low = round((box.x_mm + box.width_mm) * k), round((box.y_mm + box.height_mm) * k)
        image[top:low, left:right] = 0
    for label in page.texts:
        scale = label.height_mm * k / HERSHEY_HEIGHT_PX
        place = (round(label.x_mm * k), round(label.y_mm * k))
        cv2.putText(image, label.text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 0, max(1, round(scale * 2)), cv2.LINE_AA)
    return image


def png_of(page: Page, dpi: int) -> bytes:
    """The page as PNG with its resolution, so that programs print it at its true size."""
    good, encoded = cv2.imencode(".png", raster_of(page, dpi))
    if not good:
        raise OSError(f"page {page.name}: cannot be written as PNG")
    data = encoded.tobytes()
    head = 8 + 4 + 4 + 13 + 4  # signature and IHDR, which pHYs must follow
    per_metre = round(dpi / 0.0254)
    body = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)
    chunk = struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body))
    return data[:head] + chunk + data[head:]


# Contents of the printed pages: a marker or board at true size, a ruler, and instructions.

PAPER_SIZES_MM = {
    "a5": (148.0, 210.0),
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
}
PRINTED_RULER_LENGTH_MM = 100.0
PAGE_MARGIN_MM = 8.0  # that printers cannot reach
PAGE_FOOTER_HEIGHT_MM = 34.0  # ruler and words
TEXT_HEIGHT_MM = 3.0


def marker_page(dictionary_name: str, dictionary: "cv2.aruco.Dictionary", marker: Marker, paper: str | None) -> Page:
    """One marker upright in the middle of a page. Raises: ValueError: it does not fit on the paper."""
    side = 1e3 * marker.side_m
    quiet = side / (dictionary.markerSize + 2)
    width, height = _paper_for(side + 2 * quiet, side + 2 * quiet, paper, f"marker {marker.marker_id}")
    left, top = 0.5 * (width - side), 0.5 * (height - PAGE_FOOTER_HEIGHT_MM - side)
    words = (
        f"marker {marker.marker_id} of {dictionary_name}, on the {marker.on}: black side {side:g} mm",
        "print at 100 % (no scaling), check the ruler, keep the white around it, mount flat and stiff",
    )
    name = f"marker_{marker.marker_id}"
    shapes = (
        tuple(_marker_cells(dictionary, marker.marker_id, left, top, side)),
        tuple(_ruler_rectangles(width, height)),
    )
    return Page(name, width, height, shapes, _page_texts(words, height, left, top - quiet))


def board_page(dictionary_name: str, dictionary: "cv2.aruco.Dictionary", board: Board, paper: str | None) -> Page:
    """One board in the middle of a page. Raises: ValueError: it does not fit on the paper."""
    square, side = 1e3 * board.square_m, 1e3 * board.marker_m
    wide, high = square * board.squares_x, square * board.squares_y
    quiet = 0.5 * square if board.kind == "charuco" else 0.0  # a grid's squares are white round the markers already
    width, height = _paper_for(wide + quiet, high + quiet, paper, f"board of first_id {board.first_id}")
    left, top = 0.5 * (width - wide), 0.5 * (height - PAGE_FOOTER_HEIGHT_MM - high)
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
        (*shapes, tuple(_ruler_rectangles(width, height))),
        _page_texts(words, height, left, top - 0.5 * quiet),
    )


def _paper_for(wide_mm: float, high_mm: float, paper: str | None, what: str) -> tuple[float, float]:
    """The requested paper, or the smallest that holds it; portrait or landscape."""
    names = [paper] if paper else list(PAPER_SIZES_MM)
    for name in names:
        short, long = PAPER_SIZES_MM[name]
        for width, height in ((short, long), (long, short)):
            if wide_mm <= width - 2 * PAGE_MARGIN_MM and high_mm <= height - PAGE_FOOTER_HEIGHT_MM - PAGE_MARGIN_MM:
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


def _ruler_rectangles(width_mm: float, height_mm: float) -> list[Rectangle]:
    """100 mm with a tick every 10 mm, between the outer edges of the first and the last tick's middle lines."""
    left, base, line = 0.5 * (width_mm - PRINTED_RULER_LENGTH_MM), height_mm - PAGE_MARGIN_MM - 6.0, 0.3
    ticks = [
        Rectangle(left + x - 0.5 * line, base - (5.0 if x % 50 == 0 else 3.0), line, 5.0 if x % 50 == 0 else 3.0)
        for x in range(0, int(PRINTED_RULER_LENGTH_MM) + 1, 10)
    ]
    return [*ticks, Rectangle(left - 0.5 * line, base, PRINTED_RULER_LENGTH_MM + line, line)]


def _page_texts(words: tuple[str, str], height_mm: float, left_mm: float, top_mm: float) -> tuple[Text, ...]:
    """The words at the foot, and which edge is the top, outside the white that the marker needs."""
    lines = tuple(
        Text(PAGE_MARGIN_MM, height_mm - PAGE_FOOTER_HEIGHT_MM + 5.0 + 5.0 * k, TEXT_HEIGHT_MM * 0.8, line)
        for k, line in enumerate(words)
    )
    ruler = Text(
        PAGE_MARGIN_MM, height_mm - PAGE_MARGIN_MM + 1.0, TEXT_HEIGHT_MM * 0.8, "the ruler must measure 100 mm"
    )
    return (*lines, ruler, Text(left_mm, max(top_mm - 1.0, 4.0), TEXT_HEIGHT_MM, "top"))
