"""Pages to print: black rectangles and text in millimetres, written as SVG, PDF or PNG that say their own size."""

import struct
import zlib
from dataclasses import dataclass, field
from html import escape

import cv2
import numpy as np

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
