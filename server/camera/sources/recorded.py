"""Stereo pairs of an MCAP recording with Foxglove's images: one topic for each eye, or one of side-by-side pictures.

A cut file is played up to its last whole chunk.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from mcap.records import Channel, Message, Schema

from recording.errors import RecordingError
from recording.reader import RecordStream
from recording.writer import IMAGE_TOPIC
from server.camera.errors import CameraError, StreamError
from server.camera.sources.settings import RecordingSource
from server.camera.sources.side_by_side import decode_grey, split_side_by_side
from server.camera.sources.stamped import StampedStereoSource, StoredPair
from server.vision.contracts import Image

EYE_STAMP_GAP_MAX_NS = 2_000_000  # 0.3 mm at 0.15 m/s
UNPAIRED_IMAGES_MAX = 64  # pictures of one eye whose partner has not come

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
        return rows.copy()  # contiguous and writable as those of the others: compiled code is of one memory layout
    return np.asarray(cv2.cvtColor(rows.reshape(height, width, pixel_bytes), conversion), np.uint8)


class RecordingStereoSource(StampedStereoSource):
    """Plays a recording once. Pictures without the other eye within 2 ms are left out and counted in `skipped`."""

    def __init__(self, settings: RecordingSource) -> None:
        self._topics = (settings.pair_topic,) if settings.pair_topic else (settings.left_topic, settings.right_topic)
        path = Path(settings.path)
        _check_topics(path, self._topics)
        images = _read_topic_images(path, self._topics)
        pairs = _side_by_side(images) if settings.pair_topic else self._matched(images)
        super().__init__(f"recording {path}", pairs, settings.speed)

    def _matched(self, images: Iterator[tuple[str, StoredImage]]) -> Iterator[StoredPair]:
        """Both eyes' pictures of one time, in the order in which they are complete."""
        left_topic = self._topics[0]
        waiting: dict[bool, list[StoredImage]] = {True: [], False: []}
        for topic, image in images:
            is_left = topic == left_topic
            others = waiting[not is_left]
            other = min(others, key=lambda one: abs(one.t_ns - image.t_ns), default=None)
            if other is None or abs(other.t_ns - image.t_ns) > EYE_STAMP_GAP_MAX_NS:
                waiting[is_left].append(image)
                if len(waiting[is_left]) > UNPAIRED_IMAGES_MAX:
                    waiting[is_left].pop(0)
                    self.skipped += 1
                continue
            for eye, until_ns in ((is_left, image.t_ns), (not is_left, other.t_ns)):
                self.skipped += sum(image.t_ns < until_ns for image in waiting[eye])
                waiting[eye] = [image for image in waiting[eye] if image.t_ns > until_ns]
            yield _stored_pair(*((image, other) if is_left else (other, image)))


def _stored_pair(left: StoredImage, right: StoredImage) -> StoredPair:
    return StoredPair(left.t_ns, lambda: (left.decode(), right.decode()))


def _side_by_side(images: Iterator[tuple[str, StoredImage]]) -> Iterator[StoredPair]:
    for _, image in images:
        yield StoredPair(image.t_ns, lambda image=image: split_side_by_side(image.decode()))


def _read_topic_images(path: Path, topics: tuple[str, ...]) -> Iterator[tuple[str, StoredImage]]:
    """The pictures of these topics in the file's order."""
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    for record in RecordStream(path):
        match record:
            case Schema():
                schemas[record.id] = record.name
            case Channel():
                channels[record.id] = (record.topic, schemas.get(record.schema_id, ""))
            case Message():
                topic, schema = channels.get(record.channel_id, ("", ""))
                if topic in topics:
                    yield topic, image_of(schema, record.data, record.log_time)


def _check_topics(path: Path, topics: tuple[str, ...]) -> None:
    """Raises CameraError naming the topics that the file has, where a wanted one is missing or holds no images."""
    try:
        found = _image_topics(path)
    except RecordingError as error:
        raise CameraError(str(error)) from error
    missing = [topic for topic in topics if topic not in found]
    if not missing:
        return
    have = ", ".join(f"{topic} ({schema})" for topic, schema in sorted(found.items())) or "no channel at all"
    remedy = "set [camera] left_topic and right_topic, or pair_topic, to topics of Foxglove images"
    if found.keys() & {IMAGE_TOPIC} and missing == ["/camera/right"]:
        remedy = "longreach's own recordings keep the left eye's preview only, for looking at: record both eyes"
    raise CameraError(f"recording {path}: no images on {', '.join(missing)}; it has {have}; {remedy}")


def _image_topics(path: Path) -> dict[str, str]:
    """Topic -> schema of every channel; those that hold no images raise when they are wanted."""
    schemas: dict[int, str] = {}
    topics: dict[str, str] = {}
    any_record = False
    for record in RecordStream(path):
        any_record = True
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            schema = schemas.get(record.schema_id, "")
            if schema in IMAGE_SCHEMAS:
                topics[record.topic] = schema
    if not any_record:
        raise CameraError(f"recording {path} is not an MCAP file; give one with images of both eyes")
    return topics
