"""Rows as protobuf messages, built from the row classes: no compiler, no generated files."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any, get_type_hints

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as FieldProto
from google.protobuf.message import DecodeError, Message

from recording.errors import RecordingError
from recording.rows import ROW_TYPES, Floats, Row

PROTOBUF_PACKAGE = "longreach"

_TYPES = {
    float: (FieldProto.TYPE_DOUBLE, FieldProto.LABEL_OPTIONAL),
    int: (FieldProto.TYPE_INT64, FieldProto.LABEL_OPTIONAL),
    str: (FieldProto.TYPE_STRING, FieldProto.LABEL_OPTIONAL),
    bool: (FieldProto.TYPE_BOOL, FieldProto.LABEL_OPTIONAL),
    Floats: (FieldProto.TYPE_DOUBLE, FieldProto.LABEL_REPEATED),
}


def _file_of(row_type: type[Row]) -> descriptor_pb2.FileDescriptorProto:
    """One file per message, so that a channel's schema holds nothing but itself."""
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{PROTOBUF_PACKAGE}/{row_type.__name__}.proto", package=PROTOBUF_PACKAGE, syntax="proto3"
    )
    message = file.message_type.add(name=row_type.__name__)
    hints = get_type_hints(row_type)
    for number, column in enumerate(fields(row_type), start=1):
        kind, label = _TYPES[hints[column.name]]
        message.field.add(name=column.name, number=number, type=kind, label=label, json_name=column.name)
    return file


class RowCodec:
    """Row <-> protobuf bytes of one channel."""

    def __init__(self, row_type: type[Row]) -> None:
        file = _file_of(row_type)
        pool = descriptor_pool.DescriptorPool()
        pool.Add(file)
        self.row_type = row_type
        self.schema_name = f"{PROTOBUF_PACKAGE}.{row_type.__name__}"
        self.schema = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
        self._places = {field.name: (field.number, field.type, field.label) for field in file.message_type[0].field}
        self._names = tuple(column.name for column in fields(row_type))
        hints = get_type_hints(row_type)
        self._repeated = frozenset(name for name in self._names if hints[name] is Floats or hints[name] == Floats)
        descriptor = pool.FindMessageTypeByName(self.schema_name)
        self._message: Callable[..., Message] = message_factory.GetMessageClass(descriptor)

    def encode(self, row: Row) -> bytes:
        """The row as protobuf bytes.

        Raises: RecordingError: a value does not fit its field; names channel, field and value.
        """
        try:
            return self._message(**{name: getattr(row, name) for name in self._names}).SerializeToString()
        except (ValueError, TypeError) as error:
            raise RecordingError(f"channel {row.topic}: {self._unwritable_field_reason(row)}") from error

    def _unwritable_field_reason(self, row: Row) -> str:
        """The first field whose value cannot be written, and why."""
        for name in self._names:
            value = getattr(row, name)
            try:
                self._message(**{name: value})
            except (ValueError, TypeError) as error:
                return f"{name} = {repr(value)[:60]} cannot be written: {error}"
        return "a value cannot be written"

    def can_read(self, schema: bytes) -> bool:
        """Whether messages of this schema (a FileDescriptorSet) have our fields where ours are, if they have them."""
        try:
            files = descriptor_pb2.FileDescriptorSet.FromString(schema).file
        except DecodeError:
            return False
        found = [
            message
            for file in files
            for message in file.message_type
            if f"{file.package}.{message.name}" == self.schema_name
        ]
        if len(found) != 1:
            return False
        theirs = {field.name: (field.number, field.type, field.label) for field in found[0].field}
        return all(theirs.get(name, place) == place for name, place in self._places.items())

    def decode(self, data: bytes) -> Row:
        """The row of protobuf bytes; fields that are not there take protobuf's defaults."""
        message = self._message()
        message.ParseFromString(data)
        values: dict[str, Any] = {name: getattr(message, name) for name in self._names}
        for name in self._repeated:
            values[name] = tuple(values[name])
        return self.row_type(**values)


#: One codec per numeric channel, by topic.
ROW_CODEC_BY_TOPIC = {row_type.topic: RowCodec(row_type) for row_type in ROW_TYPES}
