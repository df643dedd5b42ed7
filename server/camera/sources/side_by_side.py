"""Side-by-side pictures: left half, right half."""

import cv2
import numpy as np

from server.camera.errors import StreamError
from server.vision.contracts import Image


def split_side_by_side(picture: Image) -> tuple[Image, Image]:
    """Left and right grey views (h, w) of a grey or BGR picture (h, 2 w)."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
    width = grey.shape[1]
    if width % 2:
        raise StreamError(f"side-by-side picture: width {width} px is odd; two equal eyes need an even width")
    half = width // 2
    return np.asarray(grey[:, :half], np.uint8), np.asarray(grey[:, half:], np.uint8)


def decode_side_by_side(jpeg: bytes) -> tuple[Image, Image]:
    """Left and right grey views of a JPEG picture.

    Raises: StreamError when the bytes are no picture.
    """
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise StreamError(f"camera picture of {len(jpeg)} bytes is not a JPEG; check the camera's encoder")
    return split_side_by_side(np.asarray(picture, np.uint8))
