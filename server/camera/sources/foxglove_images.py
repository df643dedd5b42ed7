"""Foxglove's image messages -> grey pictures."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError

from server.camera.errors import StreamError
from server.camera.sources.side_by_side import decode_grey
from server.vision.contracts import Image

COMPRESSED, RAW = "foxglove.CompressedImage", "foxglove.RawImage"
IMAGE_SCHEMAS = (COMPRESSED, RAW)
# Encoding -> bytes a pixel and what makes it grey; None: it is grey already.
ENCODINGS: dict[str, tuple[int, int | None]] = {
    "mono8": (1, None),
    "8UC1": (1, None),
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "8UC3": (3, cv2.COLOR_BGR2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    "yuyv": (2, cv2.COLOR_YUV2GRAY_YUY2),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2GRAY_YUY2),
    "uyvy": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422": (2, cv2.COLOR_YUV2GRAY_UYVY),
}


@dataclass(frozen=True, slots=True)
class StoredImage:
    """One picture, not yet decoded; `t_ns`: the message's own stamp, its log time where it has none."""

    schema: str
    message: Any
    t_ns: int

    def decode(self) -> Image:
        """Grey (h, w).

        Raises: StreamError: bytes or encoding that are no picture.
        """
        return decode_grey(bytes(self.message.data)) if self.schema == COMPRESSED else raw_to_grey(self.message)


def image_of(schema: str, data: bytes, log_time_ns: int) -> StoredImage:
    """The message's picture.

    Raises: StreamError: the bytes are not what the schema says.
    """
    try:
        message: Any = (CompressedImage if schema == COMPRESSED else RawImage).FromString(data)
    except DecodeError as error:
        raise StreamError(f"a message is not the {schema} that its channel says; repair the recording") from error
    t_ns = message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos
    return StoredImage(schema, message, t_ns or log_time_ns)


def raw_to_grey(message: Any) -> Image:
    """Grey (h, w) of a RawImage: mono8, rgb8, bgr8, rgba8, bgra8, yuyv, uyvy and their older names."""
    if message.encoding not in ENCODINGS:
        raise StreamError(f"raw image of encoding '{message.encoding}'; known are {', '.join(ENCODINGS)}")
    pixel_bytes, conversion = ENCODINGS[message.encoding]
    width, height, step = message.width, message.height, message.step or message.width * pixel_bytes
    if not (width and height) or step < width * pixel_bytes or len(message.data) < step * height:
        raise StreamError(
            f"raw image of {width} x {height} px, step {step}, has {len(message.data)} bytes; repair the recording"
        )
    rows = np.frombuffer(message.data, np.uint8, step * height).reshape(height, step)[:, : width * pixel_bytes]
    if conversion is None:
        return rows
    return np.asarray(cv2.cvtColor(rows.reshape(height, width, pixel_bytes), conversion), np.uint8)
