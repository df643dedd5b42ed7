"""What of a recording arrives in Rerun, channel by channel and value by value. Needs Rerun itself."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from longreach.rerun_view import convert, import_rerun_module
from machine.description import parse_machine_toml
from recording.messages import ROW_CODEC_BY_TOPIC
from recording.writer import CALIBRATION_TOPIC, IMAGE_TOPIC, LOG_TOPIC, TRANSFORM_TOPIC

FLOAT32_TOL = 2e-7  # Rerun keeps transforms and pinholes as float32: a share of the value, or as much of a metre
_LEVELS = {"DEBUG": 1, "INFO": 2, "WARN": 3, "ERROR": 4}
Rows = dict[str, list[Any]]
Comparisons = dict[str, tuple[Callable[[Any, Any], bool], str]]


@dataclass(frozen=True, slots=True)
class Arrival:
    """One channel: messages written, how many of them arrived with every value, and how exactly."""

    topic: str
    schema: str
    written: int
    arrived: int
    equal: int
    kind: str

    @property
    def whole(self) -> bool:
        """Nothing is lost."""
        return self.written == self.arrived == self.equal


def arrivals(recording: Path, target: Path) -> list[Arrival]:
    """Convert, and compare channel by channel.

    Raises: RerunError: no Rerun, or it failed.
    """
    written, schemas = _written(recording)
    convert(recording, target)
    there, attached = _there(target)
    same_camera = _same_camera(_distortion(attached.get("machine.toml", b"")))
    compared = _COMPARED | {CALIBRATION_TOPIC: (same_camera, "K and size as float32; the lens in machine.toml")}
    found = [
        _arrival(topic, schemas[topic], written[topic], there.get(topic, []), compared) for topic in sorted(written)
    ]
    wanted = _attachments(recording)
    equal = sum(attached.get(name) == data for name, data in wanted.items())
    return [*found, Arrival("attachments", "", len(wanted), len(attached), equal, "byte by byte")]


def _written(recording: Path) -> tuple[Rows, dict[str, str]]:
    """Messages by topic, read by Foxglove's library, and the schemas' names."""
    rows, schemas = defaultdict[str, list[Any]](list), dict[str, str]()
    with recording.open("rb") as file:
        for schema, channel, _, message in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            schemas[channel.topic] = schema.name if schema is not None else ""
            rows[channel.topic] += list(message.transforms) if channel.topic == TRANSFORM_TOPIC else [message]
    return dict(rows), schemas


def _attachments(recording: Path) -> dict[str, bytes]:
    """By name; the later one of the same name counts."""
    with recording.open("rb") as file:
        return {one.name: one.data for one in make_reader(file).iter_attachments()}


def _there(target: Path) -> tuple[Rows, dict[str, bytes]]:
    """Rows of the converted recording by entity, in the order of their log time, and its attachments by name."""
    rows, attached = defaultdict[str, list[Any]](list), dict[str, bytes]()
    for chunk in import_rerun_module("rerun.chunk").RrdReader(str(target)).stream():
        batch = chunk.to_record_batch()
        if "message_log_time" in batch.schema.names:
            rows[str(chunk.entity_path)] += batch.to_pylist()
        elif str(chunk.entity_path) == "/__mcap_attachments":
            for row in batch.to_pylist():
                names = [{one["first"]: one["second"] for one in about}["name"] for about in row["metadata"]]
                attached |= {name: bytes(data) for name, data in zip(names, row["data"], strict=True)}
    return {path: sorted(found, key=lambda row: row["message_log_time"]) for path, found in rows.items()}, attached


def _arrival(topic: str, schema: str, written: list[Any], there: list[Any], compared: Comparisons) -> Arrival:
    compare, kind = compared.get(topic, (None, ""))
    if topic in ROW_CODEC_BY_TOPIC:
        compare, kind = _same_numbers(f"{ROW_CODEC_BY_TOPIC[topic].schema_name}:message"), "every field, exactly"
    if compare is None:
        return Arrival(topic, schema, len(written), len(there), 0, "unknown channel")
    equal = sum(compare(a, b) for a, b in zip(written, there, strict=False))
    return Arrival(topic, schema, len(written), len(there), equal, kind)


def _same_numbers(column: str) -> Callable[[Any, Any], bool]:
    def same(message: Any, row: Any) -> bool:
        got = (row.get(column) or [{}])[0]
        names = [field.name for field in message.DESCRIPTOR.fields]
        return set(names) == set(got) and all(_equal(getattr(message, name), got[name]) for name in names)

    return same


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, str | bool | int):
        return a == b
    if isinstance(a, float):
        return a == b or (math.isnan(a) and math.isnan(b))
    return len(a) == len(b) and all(_equal(x, y) for x, y in zip(a, b, strict=True))


def _near(a: Iterable[float], b: Iterable[float]) -> bool:
    return np.allclose(np.array(list(a)), np.array(list(b)), rtol=FLOAT32_TOL, atol=FLOAT32_TOL)


def _same_image(message: Any, row: Any) -> bool:
    return bytes(row["EncodedImage:blob"][0]) == message.data and row["EncodedImage:media_type"] == ["image/jpeg"]


def _same_edge(edge: Any, row: Any) -> bool:
    frames = [edge.parent_frame_id], [edge.child_frame_id]
    turned = [getattr(edge.rotation, axis) for axis in "xyzw"]
    return (
        (row["Transform3D:parent_frame"], row["Transform3D:child_frame"]) == frames
        and _near((getattr(edge.translation, axis) for axis in "xyz"), row["Transform3D:translation"][0])
        and _near(turned, row["Transform3D:quaternion"][0])
    )


def _same_camera(distortion: tuple[float, ...]) -> Callable[[Any, Any], bool]:
    """K and the size; a pinhole of Rerun has no lens, which must then be that of the machine file that came along."""

    def same(message: Any, row: Any) -> bool:
        by_columns = np.array(row["Pinhole:image_from_camera"][0]).reshape(3, 3).T
        size = [message.width, message.height]
        lens = not any(message.D) or tuple(message.D) == distortion
        return lens and _near(message.K, by_columns.ravel()) and _near(size, row["Pinhole:resolution"][0])

    return same


def _distortion(machine_toml: bytes) -> tuple[float, ...]:
    return tuple(parse_machine_toml(machine_toml.decode()).camera.distortion) if machine_toml else ()


def _same_line(message: Any, row: Any) -> bool:
    level = _LEVELS.get(row["TextLog:level"][0], 0)
    return row["TextLog:text"] == [message.message] and level == message.level


_COMPARED: Comparisons = {
    IMAGE_TOPIC: (_same_image, "JPEG, byte by byte"),
    TRANSFORM_TOPIC: (_same_edge, "frames; numbers as float32"),
    LOG_TOPIC: (_same_line, "text and level"),
}
