"""A finished run as the page replays it; reading is heavy, so it is done in a process of its own.

`python -m server.api.panel_replay_reading run.mcap` writes to stdout: length of the JSON (uint32, little endian), the
JSON, then the pictures one after the other; the JSON holds their offsets.
"""

import json
import os
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.records import Message

from recording.channels import Channels
from recording.errors import RecordingError
from recording.messages import ROW_CODEC_BY_TOPIC
from recording.reader import RecordStream
from recording.rows import LookRow, PlcState, Row
from recording.writer import IMAGE_TOPIC, LOG_TOPIC

REPLAY_JOINTS_RATE_HZ = 10.0
REPLAY_PICTURES_RATE_HZ = 2.0
PICTURES_MAX = 400
REPLAY_TOPICS = (PlcState.topic, LookRow.topic, LOG_TOPIC, IMAGE_TOPIC)


def replay_of(path: Path) -> tuple[dict[str, Any], list[bytes]]:
    """What happened, in seconds from the first record: joints [deg], looks, lines of the log, pictures.

    Raises: RecordingError: nothing of ours can be read there.
    """
    joints: list[list[Any]] = []
    looks: list[list[Any]] = []
    lines: list[list[Any]] = []
    pictures: list[tuple[float, bytes]] = []
    t_zero_ns: int | None = None
    apart_s = 1.0 / REPLAY_PICTURES_RATE_HZ
    for topic, message in _wanted_messages(path):
        t_zero_ns = message.log_time if t_zero_ns is None else t_zero_ns
        t_s = round((message.log_time - t_zero_ns) * 1e-9, 3)
        if topic == LOG_TOPIC:
            lines.append([t_s, Log.FromString(message.data).message])
        elif topic == IMAGE_TOPIC:
            if not pictures or t_s - pictures[-1][0] >= apart_s:
                pictures.append((t_s, CompressedImage.FromString(message.data).data))
            if len(pictures) > PICTURES_MAX:  # of a long run every second one, to its end
                pictures, apart_s = pictures[::2], 2.0 * apart_s
        elif topic == LookRow.topic:
            looks.append([t_s, *_look_status_and_reason(ROW_CODEC_BY_TOPIC[topic].decode(message.data))])
        elif not joints or t_s - joints[-1][0] >= 1.0 / REPLAY_JOINTS_RATE_HZ:
            joints.append([t_s, *_joint_angles_and_state(ROW_CODEC_BY_TOPIC[topic].decode(message.data))])
    if t_zero_ns is None:
        raise RecordingError(f"recording {path.name} holds nothing that could be replayed")
    ends = np.cumsum([0, *(len(data) for _, data in pictures)]).tolist()
    replay = {
        "joints": joints,
        "looks": looks,
        "lines": lines,
        "pictures": [[t_s, start, end] for (t_s, _), start, end in zip(pictures, ends[:-1], ends[1:], strict=True)],
    }
    return replay, [data for _, data in pictures]


def _wanted_messages(path: Path) -> Iterator[tuple[str, Message]]:
    channels = Channels()
    for record in RecordStream(path):
        channels.take_record(record)
        if isinstance(record, Message) and (topic := channels.topic_of(record)) in REPLAY_TOPICS:
            yield topic, record


def _joint_angles_and_state(row: Row) -> list[Any]:
    if not isinstance(row, PlcState):
        raise RecordingError(f"a row of {PlcState.topic} is {type(row).__name__}")
    degrees = np.round(np.rad2deg(row.q_rad), 2).tolist()
    return [[q if np.isfinite(q) else None for q in degrees], row.plc_state]


def _look_status_and_reason(row: Row) -> list[Any]:
    if not isinstance(row, LookRow):
        raise RecordingError(f"a row of {LookRow.topic} is {type(row).__name__}")
    return [row.status, row.reason]


def main() -> None:
    """Entry point of the process; an unreadable file ends it with code 2 and the reason on stderr."""
    os.nice(10)
    try:
        replay, pictures = replay_of(Path(sys.argv[1]))
    except RecordingError as error:
        sys.stderr.write(str(error))
        raise SystemExit(2) from error
    text = json.dumps(replay, allow_nan=False).encode()
    sys.stdout.buffer.write(struct.pack("<I", len(text)) + text + b"".join(pictures))


if __name__ == "__main__":
    main()
