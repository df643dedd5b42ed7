"""Repairing a file that was cut by a crash or a full disk."""

from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment as McapAttachment
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from recording.errors import RecordingError
from recording.reader import RecordStream

RECOVERED_METADATA_NAME = "longreach/recovered"  # metadata of a file that holds what was left of another one


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """What was saved. `was_complete`: there was nothing to repair."""

    n_messages: int
    n_attachments: int
    was_complete: bool
    reason: str  # where reading ended or what was lost, in the reader's words
    lost_chunks: int = 0


def recover(source: Path, target: Path) -> RecoverReport:
    """Copy everything readable of `source`, images included, into a whole file with an index.

    Raises: RecordingError when nothing can be read, or the target exists already or cannot be written; nothing is left.
    """
    if target.exists():
        raise RecordingError(f"{target} exists already; choose another name")
    try:
        file = target.open("xb")
    except OSError as error:
        raise _unwritable_file_error(target, error) from error
    stream = RecordStream(source)
    copier = _Copier()
    try:
        with file:
            copier.copy(stream, Writer(file, compression=CompressionType.ZSTD))
        if copier.messages + copier.attachments == 0:
            raise RecordingError(f"recording {source}: nothing can be read: {stream.reason}")
    except OSError as error:
        target.unlink(missing_ok=True)
        raise _unwritable_file_error(target, error) from error
    except RecordingError:
        target.unlink(missing_ok=True)  # an empty one would be in the next one's way
        raise
    return RecoverReport(copier.messages, copier.attachments, not stream.cut, stream.reason, stream.lost_chunks)


def _unwritable_file_error(target: Path, error: OSError) -> RecordingError:
    return RecordingError(f"{target} cannot be written: {error.strerror}; choose a folder that can be written")


class _Copier:
    def __init__(self) -> None:
        self.messages = 0
        self.attachments = 0
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}

    def copy(self, stream: RecordStream, writer: Writer) -> None:
        writer.start(profile="", library="longreach recover")
        for record in stream:
            match record:
                case Schema() if record.id not in self._schemas:
                    self._schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                case Channel() if record.id not in self._channels:
                    schema = self._schemas.get(record.schema_id, 0)  # one that is missing: the messages are saved
                    self._channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schema, record.metadata
                    )
                case Message():
                    self._copy_message(writer, record)
                case McapAttachment():
                    self.attachments += 1
                    writer.add_attachment(
                        record.create_time, record.log_time, record.name, record.media_type, record.data
                    )
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
        if stream.cut:
            lost = {"lost_chunks": str(stream.lost_chunks), "reason": stream.reason or "it ended too early"}
            writer.add_metadata(RECOVERED_METADATA_NAME, lost)
        writer.finish()

    def _copy_message(self, writer: Writer, record: Message) -> None:
        self.messages += 1
        channel = self._channels[record.channel_id]
        writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
