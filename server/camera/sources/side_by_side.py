"""Side-by-side pictures: left half, right half."""

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from server.camera.errors import StreamError
from server.camera.sources.jpeg_scan import damage_of
from server.vision.contracts import Image

JPEG_MAGIC = b"\xff\xd8"
DAMAGED_PICTURE_REMEDY = (
    "check cable, network and USB port; if every picture is refused, the camera's encoder does not keep to the "
    "standard: use its uncompressed format (pixel_format = 'YUYV')"
)


def split_side_by_side(picture: Image) -> tuple[Image, Image]:
    """Left and right grey pictures (h, w) of a grey or BGR picture (h, 2 w), each contiguous.

    Contiguous as those of every other source: compiled code is of one memory layout, and a view of another one would be
    compiled at the first picture, for a minute.
    """
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
    width = grey.shape[1]
    if width % 2:
        raise StreamError(f"side-by-side picture: width {width} px is odd; two equal eyes need an even width")
    half = width // 2
    return np.ascontiguousarray(grey[:, :half], np.uint8), np.ascontiguousarray(grey[:, half:], np.uint8)


def decode_grey(data: bytes | NDArray[np.uint8]) -> Image:
    """Grey picture (h, w) of JPEG or PNG bytes, decoded straight to grey.

    Raises: StreamError when the bytes are not a picture, or a JPEG whose data are damaged (PNG has checksums).
    """
    encoded = np.frombuffer(memoryview(cast(bytes, data)).toreadonly(), np.uint8)  # one type for the compiled scan
    damage = damage_of(encoded) if encoded[: len(JPEG_MAGIC)].tobytes() == JPEG_MAGIC else ""
    if damage:
        size = f"camera picture of {encoded.size} bytes"
        raise StreamError(f"{size} is damaged, not a JPEG as an encoder writes it: {damage}; {DAMAGED_PICTURE_REMEDY}")
    picture = cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE) if encoded.size else None
    if picture is None:
        raise StreamError(f"camera picture of {encoded.size} bytes is not a JPEG; check the camera's encoder")
    return np.asarray(picture, np.uint8)


def decode_side_by_side(data: bytes | NDArray[np.uint8]) -> tuple[Image, Image]:
    """Left and right grey pictures of a JPEG picture.

    Raises: StreamError as `decode_grey`, or an odd width.
    """
    return split_side_by_side(decode_grey(data))
