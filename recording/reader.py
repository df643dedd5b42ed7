"""Reading MCAP recordings, whole or cut."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Attachment as McapAttachment
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from recording.channels import Channels
from recording.content import Attachment, LogEntry, Recording
from recording.errors import RecordingError
from recording.files import text_of
from recording.foxglove import LOG_LEVEL_NUMBERS
from recording.messages import ROW_CODEC_BY_TOPIC
from recording.rows import Row
from recording.run import RunInfo, run_from_toml
from recording.writer import IMAGE_TOPIC, LOG_TOPIC

# What the MCAP reader raises on bytes that end or are damaged; its decompressors have errors of their own. Overflow and
# memory: a damaged size of a chunk, which they believe. LZ4 raises plain runtime errors.
# fmt: off
TRUNCATED_FILE_ERRORS = (
    McapError, EOFError, struct.error, zlib.error, ValueError, KeyError, OSError, OverflowError, MemoryError,
    RuntimeError,
)
# fmt: on

LEVEL_NAMES = {number: name for name, number in LOG_LEVEL_NUMBERS.items()}


class RecordStream:
    """The records of an MCAP file in order, until its end or the first unreadable record. `cut` states which.

    A damaged chunk is left out and counted (`lost_chunks`): the next one is framed by its length. A message whose
    channel was never declared is damage, too, and left out: its meaning is unknown.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: set[int] = {0}  # MCAP's number of no schema
        self._channels: set[int] = set()
        self.cut = False
        self.reason = ""
        self.lost_chunks = 0

    def __iter__(self) -> Iterator[McapRecord]:
        try:
            stream = self._path.open("rb")
        except OSError as error:
            raise RecordingError(f"recording {self._path}: {error.strerror}") from error
        with stream:
            ended = False
            size_limit = self._path.stat().st_size  # a damaged length must not fill the memory
            reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=size_limit)
            records = reader.records
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    break
                except Exception as error:
                    self._note_damage_or_raise(error)
                    break
                ended = isinstance(record, Footer)
                for inner in self._read_chunk_records(record) if isinstance(record, Chunk) else (record,):
                    if self._has_declared_channel(inner):
                        yield inner
            self.cut = self.cut or not ended

    def _read_chunk_records(self, chunk: Chunk) -> list[McapRecord]:
        try:
            return breakup_chunk(chunk, validate_crc=True)
        except Exception as error:
            self._note_damage_or_raise(error)
            self.lost_chunks += 1
            return []

    def _note_damage_or_raise(self, error: Exception) -> None:
        if not isinstance(error, TRUNCATED_FILE_ERRORS) and type(error).__module__.split(".")[0] not in (
            "zstandard",
            "lz4",
        ):
            raise error
        said = str(error) or type(error).__name__
        self._mark_damaged(said if self._path.stat().st_size else "it is empty")

    def _mark_damaged(self, reason: str) -> None:
        self.cut, self.reason = True, self.reason or reason

    def _has_declared_channel(self, record: McapRecord) -> bool:
        """Whether what a record refers to was declared before it; a channel without its schema still has a topic."""
        match record:
            case Schema():
                self._schemas.add(record.id)
            case Channel():
                self._channels.add(record.id)
                if record.schema_id not in self._schemas:
                    self._mark_damaged(f"the schema of channel {record.topic} is missing")
            case Message() if record.channel_id not in self._channels:
                self._mark_damaged(f"the record of channel {record.channel_id} is missing")
                return False
        return True


def read_mcap(path: Path) -> Recording:
    """The numbers, log and attachments of an MCAP file; of a cut file what can be read.

    Raises: RecordingError when it is not an MCAP file or holds no longreach channel.
    """
    stream = RecordStream(path)
    collected = _CollectedRecords()
    for record in stream:
        collected.take(record)
    if not collected.any_record:
        raise RecordingError(f"recording {path} is not an MCAP file: {stream.reason}")
    return collected.recording(complete=not stream.cut)


class _CollectedRecords:
    def __init__(self) -> None:
        self._channels = Channels()
        self._rows: list[Row] = []
        self._log: list[LogEntry] = []
        self._attachments: dict[str, Attachment] = {}
        self._metadata: list[tuple[str, str]] = []
        self._images = 0
        self.any_record = False

    def take(self, record: McapRecord) -> None:
        self.any_record = True
        self._channels.take_record(record)
        match record:
            case Message():
                self._message(record)
            case McapAttachment():  # a later one of the same name is the better one
                self._attachments[record.name] = Attachment(record.name, record.media_type, record.data)
            case Metadata():
                self._metadata += [(f"{record.name}.{key}", value) for key, value in record.metadata.items()]

    def _message(self, record: Message) -> None:
        topic = self._channels.topic_of(record)
        try:
            if topic in ROW_CODEC_BY_TOPIC:
                self._rows.append(ROW_CODEC_BY_TOPIC[topic].decode(record.data))
            elif topic == LOG_TOPIC:
                entry: Any = Log.FromString(record.data)
                level = LEVEL_NAMES.get(int(entry.level), "unknown")
                self._log.append(LogEntry(record.log_time, level, entry.message))
            elif topic == IMAGE_TOPIC:
                self._images += 1
        except DecodeError as error:
            raise RecordingError(f"channel {topic}: a message does not match its schema: {error}") from error

    def recording(self, complete: bool) -> Recording:
        attachments = dict(self._attachments)
        run = attachments.pop("run.toml", None)
        info = RunInfo(name="") if run is None else run_from_toml(_attachment_text(run))
        machine = attachments.pop("machine.toml", None)
        return Recording(
            storage_format="mcap",
            run_info=info,
            machine_toml="" if machine is None else _attachment_text(machine),
            rows=tuple(self._rows),
            log_entries=tuple(self._log),
            attachments=tuple(attachments.values()),
            metadata=tuple(self._metadata),
            n_images=self._images,
            complete=complete and not info.cut,
            foreign_channels=self._channels.foreign,
        )


def _attachment_text(attachment: Attachment) -> str:
    try:
        return text_of(attachment.data)
    except OSError as error:
        raise RecordingError(f"attachment {attachment.name} cannot be read: {error.strerror}") from error
