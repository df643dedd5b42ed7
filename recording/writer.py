"""Writing one run as MCAP: a queue, a thread, one file that is readable up to its last chunk whatever happens.

Under pressure images are dropped first and counted. Numbers never: where minutes of them wait for a disk, a conversion
waits too, and a live recording ends there and says so, since a machine is commanded by the process that gives them.
"""

import contextlib
import logging
import os
import queue
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from google.protobuf.message import Message
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_protobuf.schema import build_file_descriptor_set

from machine.description import StereoCamera
from recording.clock import mono_ns, mono_s
from recording.content import Attachment
from recording.errors import RecordingError
from recording.foxglove import (
    STRING_SCHEMA,
    STRING_SCHEMA_NAME,
    FramePose,
    calibration_message,
    description_json,
    image_message,
    joint_states_message,
    log_message,
    transforms_message,
)
from recording.messages import ROW_CODEC_BY_TOPIC
from recording.rows import Row
from recording.run import RunInfo, run_to_toml

QUEUE_ENTRIES_MAX = 50_000  # minutes of numbers
QUEUED_IMAGES_MAX = 16  # waiting images; a disk that is further behind loses images
CHUNK_BYTES = 256 * 1024
OPEN_TIMEOUT_S = 30.0
FLUSH_PERIOD_S = 1.0  # at most this much is lost when the process is killed
CLOSE_TIMEOUT_S = 30.0
RECOVERABLE_ROWS_HINT = "the rows written so far can be recovered"
QUEUE_PUT_TIMEOUT_S = 0.5  # between two looks at whether the thread that empties the queue is still there
MCAP_TIME_MAX_NS = 2**64 - 1  # what MCAP's times hold

IMAGE_TOPIC = "/camera/left"
CALIBRATION_TOPIC = "/camera/left/calibration"
TRANSFORM_TOPIC = "/tf"
LOG_TOPIC = "/log"
JOINT_TOPIC = "/joint_states"
ROBOT_DESCRIPTION_TOPIC = "/robot_description"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _QueuedMessage:
    topic: str
    content: Row | Message | str  # text: JSON, of the robot's description
    log_ns: int
    publish_ns: int


@dataclass(frozen=True, slots=True)
class WriterReport:
    """What became of a run's file."""

    path: Path
    n_messages: int
    images_dropped: int
    error: str  # empty when everything was written


class RunWriter:
    """One run's file. Times given are the PC's monotonic clock [ns]; the file carries UTC.

    `patient`: whether a giver waits for a disk that is behind by QUEUE_ENTRIES_MAX.
    `open_wait_s`: how long the giver waits for the file to be there; after that what is given waits for it.

    Raises: RecordingError where the file cannot be made, if that is known within `open_wait_s`; else `error` says so.
    """

    def __init__(
        self,
        path: Path,
        run: RunInfo,
        attachments: Sequence[Attachment] = (),
        metadata: Sequence[tuple[str, str]] = (),
        mono_to_utc_ns: int | None = None,
        *,
        patient: bool = False,
        open_wait_s: float = OPEN_TIMEOUT_S,
    ) -> None:
        self.path, self._patient = path, patient
        self._mono_to_utc_ns = time.time_ns() - mono_ns() if mono_to_utc_ns is None else mono_to_utc_ns
        self._queue: queue.Queue[_QueuedMessage | None] = queue.Queue(QUEUE_ENTRIES_MAX)  # None: nothing but a wake-up
        self._closing = threading.Event()
        self._final_run: RunInfo | None = None
        self._images_waiting = 0
        self._lock = threading.Lock()
        self._error = ""
        self._messages = 0
        self.images_dropped = 0
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        self._stream: BinaryIO | None = None
        begun, opened = (
            [Attachment("run.toml", "application/toml", run_to_toml(run).encode()), *attachments],
            threading.Event(),
        )
        self._thread = threading.Thread(
            target=self._run_writer_thread, args=(begun, metadata, opened), name="recording", daemon=True
        )
        self._thread.start()
        if opened.wait(open_wait_s) and self._error:
            self._closing.set()  # no caller gets this object, so no caller could end its thread
            with contextlib.suppress(queue.Full):
                self._queue.put_nowait(None)
            raise RecordingError(self._error)

    def _open(self, attachments: Sequence[Attachment], metadata: Sequence[tuple[str, str]]) -> None:
        """Thread: make the file and what stands at its head; `error` says where that failed."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self.path.open("xb")
            self._writer = McapWriter(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
            self._writer.start(profile="", library="longreach")
            for attachment in attachments:
                self._write_attachment(attachment)
            self._writer.add_metadata("longreach", dict(metadata))
        except OSError as error:
            self._error = f"recording {self.path}: {error.strerror}; choose a folder that can be written"
            _log.error(self._error)

    @property
    def error(self) -> str:
        """Why the file is no longer written; empty while it is."""
        return self._error

    def row(self, row: Row, t_mono_ns: int, t_source_mono_ns: int | None = None) -> None:
        """Write numbers. `t_source_mono_ns`: the source's own stamp mapped to the PC's clock."""
        self._put_number(row.topic, row, t_mono_ns, t_source_mono_ns)

    def transforms(self, poses: Sequence[FramePose], t_mono_ns: int) -> None:
        """Write edges of the transform tree."""
        self._put_number(TRANSFORM_TOPIC, transforms_message(poses, self._utc_from_mono_ns(t_mono_ns)), t_mono_ns)

    def joint_states(self, names: Sequence[str], q_rad: Sequence[float], t_mono_ns: int) -> None:
        """Write encoder angles by the URDF's joint names [rad]: a viewer moves the robot of `robot` by them."""
        self._put_number(JOINT_TOPIC, joint_states_message(names, q_rad, self._utc_from_mono_ns(t_mono_ns)), t_mono_ns)

    def robot(self, urdf: str, t_mono_ns: int) -> None:
        """Write the robot's description, for viewers that draw it."""
        self._put_number(ROBOT_DESCRIPTION_TOPIC, description_json(urdf), t_mono_ns)

    def log(self, level: str, text: str, t_mono_ns: int) -> None:
        """Write one line of the log; level is debug, info, warning or error."""
        self._put_number(LOG_TOPIC, log_message(level, text, self._utc_from_mono_ns(t_mono_ns)), t_mono_ns)

    def camera(self, camera: StereoCamera, width_px: int, t_mono_ns: int) -> None:
        """Write the left eye's intrinsics for images of this width."""
        message = calibration_message(camera, self._utc_from_mono_ns(t_mono_ns), width_px)
        self._put_number(CALIBRATION_TOPIC, message, t_mono_ns)

    def image(self, jpeg: bytes, t_mono_ns: int, t_source_mono_ns: int) -> bool:
        """Write the left image unless the writer is behind; whether it was taken."""
        with self._lock:
            taken = self._images_waiting < QUEUED_IMAGES_MAX and self._queue.qsize() < QUEUE_ENTRIES_MAX // 2
            if not taken:
                self.images_dropped += 1
                return False
            self._images_waiting += 1
        self._put_number(
            IMAGE_TOPIC, image_message(jpeg, self._utc_from_mono_ns(t_source_mono_ns)), t_mono_ns, t_source_mono_ns
        )
        return True

    @property
    def is_open(self) -> bool:
        """Whether there is a file."""
        return self._stream is not None

    @property
    def has_ended(self) -> bool:
        """Whether nothing more comes into the file: after `close`, and after a wait that was too short once it did."""
        return not self._thread.is_alive()

    def close(self, run: RunInfo | None = None, wait_s: float = CLOSE_TIMEOUT_S) -> WriterReport:
        """Write what waits, the final run.toml and the index. The file is complete afterwards.

        A disk may take longer than `wait_s`: the report says so then, the file is written to its end all the same, and
        `has_ended` and `error` state when and how.
        """
        if not self._closing.is_set():
            self._final_run = run
            self._closing.set()
            with contextlib.suppress(queue.Full):  # who has so much to write need not be woken
                self._queue.put_nowait(None)
        self._thread.join(wait_s)
        slow = "" if self.has_ended else f"recording {self.path}: the disk has not taken all of it within {wait_s:g} s"
        return WriterReport(self.path, self._messages, self.images_dropped, self._error or slow)

    def _finish(self) -> None:
        try:
            if not self._error:
                if self._final_run is not None:
                    self._write_attachment(
                        Attachment("run.toml", "application/toml", run_to_toml(self._final_run).encode())
                    )
                self._writer.add_metadata("longreach/end", {"images_dropped": str(self.images_dropped)})
                self._writer.finish()
                self._require_name()
        except Exception as error:  # whatever it is, the report says so and the run's end goes on
            self._set_first_error(error)
        finally:
            self._close_stream()

    def _require_name(self) -> None:
        """Raises: RecordingError: what is written goes into a file that has no name any more."""
        if self._stream is not None and os.fstat(self._stream.fileno()).st_nlink == 0:
            raise RecordingError("the file was removed while it was written; its rows are lost")

    def _close_stream(self) -> None:
        if self._stream is None:
            return
        try:
            self._stream.close()
        except OSError as error:  # closing writes what its buffer still held
            self._set_first_error(error)

    def _utc_from_mono_ns(self, t_mono_ns: int) -> int:
        return t_mono_ns + self._mono_to_utc_ns

    def _put_number(
        self, topic: str, content: Row | Message | str, t_mono_ns: int, t_source_mono_ns: int | None = None
    ) -> None:
        if self._error or self._closing.is_set():
            return
        publish_ns = t_mono_ns if t_source_mono_ns is None else t_source_mono_ns
        entry = _QueuedMessage(topic, content, self._utc_from_mono_ns(t_mono_ns), self._utc_from_mono_ns(publish_ns))
        if self._patient:
            return self._enqueue_entry(entry)
        try:
            self._queue.put_nowait(entry)
        except queue.Full:
            self._set_first_error(
                RecordingError(
                    f"{QUEUE_ENTRIES_MAX} entries wait for the disk, and no more are accepted: free disk space"
                )
            )

    def _enqueue_entry(self, entry: _QueuedMessage) -> None:
        """Wait for room as long as the writer thread runs."""
        while self._thread.is_alive():
            try:
                return self._queue.put(entry, timeout=QUEUE_PUT_TIMEOUT_S)
            except queue.Full:
                continue

    def _run_writer_thread(
        self, begun: Sequence[Attachment], metadata: Sequence[tuple[str, str]], opened: threading.Event
    ) -> None:
        """Thread: the file's head, entries from the queue, a chunk at least every FLUSH_PERIOD_S, then the file's end.

        Whatever goes wrong ends the file and never the thread: it keeps emptying the queue, so that no producer waits.
        """
        try:
            self._open(begun, metadata)
            opened.set()
            flushed_s = mono_s()
            while not (self._closing.is_set() and self._queue.empty()):
                flushed_s = self._process_next_entry(flushed_s)
        except BaseException:  # the interpreter ends it: nothing more is taken, and the file has no index
            self._set_first_error(RecordingError("the writer thread has ended"))
            raise
        finally:
            self._finish()

    def _process_next_entry(self, flushed_s: float) -> float:
        try:
            entry = self._queue.get(timeout=FLUSH_PERIOD_S)
        except queue.Empty:
            entry = None
        try:
            self._write_unless_failed(entry)
            if mono_s() - flushed_s >= FLUSH_PERIOD_S and not self._error:
                flushed_s = mono_s()
                self._writer.flush()
                self._require_name()
        except Exception as error:  # a row that cannot be written must not stop the machine
            self._set_first_error(error)
        return flushed_s

    def _write_unless_failed(self, entry: _QueuedMessage | None) -> None:
        if entry is None:
            return
        if entry.topic == IMAGE_TOPIC:
            with self._lock:
                self._images_waiting -= 1
        if not self._error:
            self._write(entry)

    def _set_first_error(self, error: Exception) -> None:
        if self._error:
            return  # what came first is the cause
        why = error.strerror if isinstance(error, OSError) else str(error)
        self._error = f"recording {self.path}: {why or repr(error)}; {RECOVERABLE_ROWS_HINT}"
        _log.error(self._error)

    def _write(self, entry: _QueuedMessage) -> None:
        content = entry.content
        data = _bytes_of(entry.topic, content)
        if not 0 <= entry.log_ns <= MCAP_TIME_MAX_NS:
            limits = f"outside 0 .. {MCAP_TIME_MAX_NS} ns since 1970"
            raise RecordingError(f"channel {entry.topic}: log time {entry.log_ns} ns is {limits}; set the PC's clock")
        stamped = 0 <= entry.publish_ns <= MCAP_TIME_MAX_NS  # MCAP: a stamp that is not known is the log time
        number = self._sequence.get(entry.topic, 0)
        self._sequence[entry.topic] = number + 1
        self._writer.add_message(
            channel_id=self._get_or_register_channel(entry),
            log_time=entry.log_ns,
            data=data,
            publish_time=entry.publish_ns if stamped else entry.log_ns,
            sequence=number,
        )
        self._messages += 1

    def _get_or_register_channel(self, entry: _QueuedMessage) -> int:
        if entry.topic not in self._channels:
            name, schema = _schema_of(entry.topic, entry.content)
            message, described = ("json", "jsonschema") if isinstance(entry.content, str) else ("protobuf", "protobuf")
            schema_id = self._writer.register_schema(name, described, schema)
            self._channels[entry.topic] = self._writer.register_channel(entry.topic, message, schema_id)
        return self._channels[entry.topic]

    def _write_attachment(self, attachment: Attachment) -> None:
        now_ns = time.time_ns()
        self._writer.add_attachment(now_ns, now_ns, attachment.name, attachment.media_type, attachment.data)


def _bytes_of(topic: str, content: Row | Message | str) -> bytes:
    if isinstance(content, str):
        return content.encode()
    return ROW_CODEC_BY_TOPIC[topic].encode(content) if isinstance(content, Row) else content.SerializeToString()


def _schema_of(topic: str, content: Row | Message | str) -> tuple[str, bytes]:
    if isinstance(content, str):
        return STRING_SCHEMA_NAME, STRING_SCHEMA
    if isinstance(content, Row):
        codec = ROW_CODEC_BY_TOPIC[topic]
        return codec.schema_name, codec.schema
    return content.DESCRIPTOR.full_name, build_file_descriptor_set(type(content)).SerializeToString()
