"""Which channels of an MCAP file are of this format: by topic, encoding and schema together.

Why: others give the same topics to other messages, `/odometry` and `/log` above all.
"""

from collections import Counter

from mcap.records import Channel, McapRecord, Message, Schema

from recording.foxglove import STRING_SCHEMA_NAME
from recording.messages import ROW_CODEC_BY_TOPIC
from recording.writer import (
    CALIBRATION_TOPIC,
    IMAGE_TOPIC,
    JOINT_TOPIC,
    LOG_TOPIC,
    ROBOT_DESCRIPTION_TOPIC,
    TRANSFORM_TOPIC,
)

DEFAULT_ENCODING = "protobuf"
SCHEMA_NAME_BY_TOPIC = {topic: codec.schema_name for topic, codec in ROW_CODEC_BY_TOPIC.items()} | {
    IMAGE_TOPIC: "foxglove.CompressedImage",
    CALIBRATION_TOPIC: "foxglove.CameraCalibration",
    TRANSFORM_TOPIC: "foxglove.FrameTransforms",
    LOG_TOPIC: "foxglove.Log",
    JOINT_TOPIC: "foxglove.JointStates",
    ROBOT_DESCRIPTION_TOPIC: STRING_SCHEMA_NAME,
}
ENCODINGS_BY_TOPIC = {ROBOT_DESCRIPTION_TOPIC: ("json", "jsonschema")}  # of message and schema; all others are protobuf


class Channels:
    """Takes a file's records in order; says of each message whose it is."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._fitting: dict[int, bool] = {}
        self._foreign: Counter[int] = Counter()

    def take_record(self, record: McapRecord) -> None:
        """Learn of a schema or a channel; other records say nothing here."""
        match record:
            case Schema():
                if self._schemas.get(record.id) != record:  # the summary repeats them
                    self._fitting.pop(record.id, None)
                self._schemas[record.id] = record
            case Channel():
                self._channels[record.id] = record

    def topic_of(self, message: Message) -> str:
        """The topic of a message of this format; empty for a foreign message, which is counted."""
        channel = self._channels[message.channel_id]
        schema = self._schemas.get(channel.schema_id)
        encodings = (channel.message_encoding, "" if schema is None else schema.encoding)
        expected = ENCODINGS_BY_TOPIC.get(channel.topic, (DEFAULT_ENCODING, DEFAULT_ENCODING))
        ours = SCHEMA_NAME_BY_TOPIC.get(channel.topic) == (schema and schema.name) and encodings == expected
        if ours and schema is not None and self._has_expected_layout(channel.topic, schema):
            return channel.topic
        self._foreign[message.channel_id] += 1
        return ""

    def _has_expected_layout(self, topic: str, schema: Schema) -> bool:
        """Whether a message's fields have the numbers and types of ours: another layout would be read as nonsense."""
        if schema.id not in self._fitting:
            self._fitting[schema.id] = topic not in ROW_CODEC_BY_TOPIC or ROW_CODEC_BY_TOPIC[topic].can_read(
                schema.data
            )
        return self._fitting[schema.id]

    @property
    def foreign(self) -> tuple[str, ...]:
        """Channels whose messages are not of this format, each in words."""
        return tuple(self._unread_channel_text(number, count) for number, count in self._foreign.items())

    def _unread_channel_text(self, number: int, count: int) -> str:
        channel = self._channels[number]
        schema = self._schemas.get(channel.schema_id)
        name = "no schema" if schema is None else f"schema {schema.name!r}"
        if schema is not None and self._fitting.get(schema.id) is False:
            name += " of another layout"
        return f"{channel.topic} ({channel.message_encoding or 'no encoding'}, {name}): {count} messages were not read"
