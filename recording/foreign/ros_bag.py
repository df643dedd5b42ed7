"""The messages of a ROS bag, without ROS: rosbag2 (sqlite3, MCAP), MCAP files of ROS 1 and 2, and ROS 1 bags."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Channel, McapRecord, Message, Schema, Statistics

from recording.errors import RecordingError
from recording.reader import RecordStream

ROSBAGS_INSTALL_HINT = "reading ROS bags needs the library rosbags: pip install 'longreach[ros]'"
ROS_MESSAGE_ENCODINGS = ("cdr", "ros1")
LFS_POINTER_MAX_BYTES = 1024  # bytes
BAG_METADATA_FILE_NAME = "metadata.yaml"

_STATE = """std_msgs/Header header
string[] joint_names
{points}
"""
_POINT = "trajectory_msgs/JointTrajectoryPoint {name}\n"
_MULTI = "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_{name}\n"


def _controller_state_definition(names: tuple[str, ...], multi: tuple[str, ...] = (), last: str = "") -> str:
    """A controller state's definition, whose fields differ between the distributions of ROS 2."""
    several = "string[] multi_dof_joint_names\n" if multi else ""
    points = "".join(_POINT.format(name=name) for name in names)
    return _STATE.format(points=points + several + "".join(_MULTI.format(name=name) for name in multi) + last)


CONTROLLER_STATE_TYPE = "control_msgs/msg/JointTrajectoryControllerState"
_NOW = ("reference", "feedback", "error", "output")
_HUMBLE = (*_NOW, "desired", "actual")
#: control_msgs is in no store of rosbags, and bags before ROS 2 Iron hold no definitions: newest first, tried in turn.
CONTROLLER_STATE_DEFINITIONS = (
    _controller_state_definition(_NOW, _NOW, "float64 speed_scaling_factor\n"),
    _controller_state_definition(_NOW, _NOW),
    _controller_state_definition(_HUMBLE, _HUMBLE),
    _controller_state_definition(("desired", "actual", "error")),
)
EXTRA_MESSAGE_DEFINITIONS = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "control_msgs/msg/DynamicJointState": "std_msgs/Header header\nstring[] joint_names\n"
    "control_msgs/InterfaceValue[] interface_values\n",
}


@dataclass(frozen=True, slots=True)
class RosMessage:
    """One message: its topic and type, the time it was recorded at [ns], and its fields when `decode` is called."""

    topic: str
    message_type: str
    t_ns: int
    decode: Callable[[], Any]


class NotDecodedError(Exception):
    """A message that is not what its type says, or whose type is not known; says why."""


def is_ros(path: Path) -> bool:
    """Whether a path is a ROS bag: by its ending, its metadata, or the encoding of an MCAP file's first channel."""
    try:
        if path.is_dir():
            return (path / BAG_METADATA_FILE_NAME).is_file() or any(_storage_files(path))
        if not path.is_file():
            return False
    except OSError:
        return False
    if path.suffix in (".db3", ".bag"):
        return True
    return path.suffix == ".mcap" and _first_encoding(path) in ROS_MESSAGE_ENCODINGS


def _storage_files(folder: Path) -> Iterator[Path]:
    """Files of a rosbag2 folder: data bases, and MCAP files of ROS."""
    yield from sorted(folder.glob("*.db3"))
    yield from (path for path in sorted(folder.glob("*.mcap")) if _first_encoding(path) in ROS_MESSAGE_ENCODINGS)


def _first_encoding(path: Path) -> str:
    for record in RecordStream(path):
        if isinstance(record, Channel):
            return record.message_encoding
    return ""


class RosBag:
    """A bag that is read once, in its own order, one message at a time: memory stays bounded whatever its size.

    `notes`: what is wrong with the file. `cut`: it could not be read to its end.
    """

    def __init__(self, path: Path) -> None:
        try:
            import rosbags.rosbag2  # noqa: F401 - here: an extra
        except ImportError as error:
            raise RecordingError(ROSBAGS_INSTALL_HINT) from error
        self._path = path
        self._types = _MessageDecoders()
        self.notes: list[str] = []
        self.cut = False

    def __iter__(self) -> Iterator[RosMessage]:
        """Raises: RecordingError: no bag, or nothing of it can be read."""
        if self._path.is_dir() and not (self._path / BAG_METADATA_FILE_NAME).is_file():
            self.notes.append(f"{BAG_METADATA_FILE_NAME} is missing; the storage files are read as they are")
            for path in _storage_files(self._path):
                yield from self._read_file_messages(path)
        elif self._path.is_dir():
            yield from self._read_folder_messages()
        else:
            yield from self._read_file_messages(self._path)

    def _read_file_messages(self, path: Path) -> Iterator[RosMessage]:
        yield from self._read_mcap_messages(path) if path.suffix == ".mcap" else self._read_with_rosbags(path)

    def _read_folder_messages(self) -> Iterator[RosMessage]:
        """An uncompressed MCAP bag file by file, so that a cut one is read as far as it goes; others by rosbags."""
        files = sorted(self._path.glob("*.mcap"))
        if (
            files
            and not any(self._path.glob("*.zstd"))
            and "compression_mode: MESSAGE" not in self._read_metadata_text()
        ):
            for path in files:
                yield from self._read_mcap_messages(path)
        else:
            yield from self._read_with_rosbags(self._path)

    def _read_metadata_text(self) -> str:
        try:
            return (self._path / BAG_METADATA_FILE_NAME).read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            raise RecordingError(f"{self._path / BAG_METADATA_FILE_NAME} cannot be read: {error.strerror}") from error

    def _read_mcap_messages(self, path: Path) -> Iterator[RosMessage]:
        stream = RecordStream(path)
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        records = messages = written = 0
        for record in stream:
            records += 1
            written = record.message_count if isinstance(record, Statistics) else written
            if isinstance(record, Message):
                messages += 1
                channel = channels[record.channel_id]
                yield self._of_mcap(record, channel, schemas.get(channel.schema_id))
            else:
                _store_schema_or_channel(record, schemas, channels)
        if not records:
            raise RecordingError(f"{path} is not an MCAP file: {stream.reason}")
        if written > messages and not stream.cut:  # chunks without check sums: damage shows by the count only
            self.cut = True
            self.notes.append(f"{path.name} is damaged: {written - messages} of its {written} messages cannot be read")
        if stream.cut:
            self.cut = True
            lost = f"; {stream.lost_chunks} damaged chunks are left out" if stream.lost_chunks else ""
            self.notes.append(
                f"{path.name} is cut or damaged ({stream.reason or 'it has no end'}){lost}: used up to there"
            )

    def _of_mcap(self, message: Message, channel: Channel, schema: Schema | None) -> RosMessage:
        kind = _full_type("" if schema is None else schema.name)
        text = "" if schema is None else schema.data.decode("utf-8", errors="replace")
        style = "" if schema is None else schema.encoding

        def decode() -> Any:
            return self._types.decode_message(kind, channel.message_encoding, message.data, text, style)

        return RosMessage(channel.topic, kind, message.log_time, decode)

    def _read_with_rosbags(self, path: Path) -> Iterator[RosMessage]:
        """Raises: RecordingError: not a bag, or nothing of it can be read."""
        from rosbags import rosbag1, rosbag2

        encoding = "ros1" if path.suffix == ".bag" else "cdr"
        read = 0
        try:
            with rosbag1.Reader(path) if encoding == "ros1" else rosbag2.Reader(path) as bag:
                for connection, t_ns, data in bag.messages(list(bag.connections)):
                    read += 1
                    definition = connection.msgdef
                    kind, text, style = connection.msgtype, str(definition.data), definition.format.name

                    def decode(kind: str = kind, data: bytes = data, text: str = text, style: str = style) -> Any:
                        return self._types.decode_message(kind, encoding, data, text, style)

                    yield RosMessage(connection.topic, kind, t_ns, decode)
        except RecordingError:
            raise
        except Exception as error:  # sqlite, yaml, zstd and struct have errors of their own
            why = str(error) or type(error).__name__
            if not read:
                raise RecordingError(f"bag {path} cannot be read: {why}; {_repair(path)}") from error
            self.cut = True
            self.notes.append(f"{path.name} is cut or damaged ({why}): used up to there, {read} messages")


def _repair(path: Path) -> str:
    if not path.exists():
        return "check its path"
    if (
        path.is_file()
        and path.stat().st_size < LFS_POINTER_MAX_BYTES
        and path.read_bytes().startswith(b"version https://git-lfs")
    ):
        return "it is a pointer of Git LFS: fetch the file itself by `git lfs pull`"
    if path.suffix == ".bag":
        return "record it again, or repair it by `rosbag reindex`"
    return "record it again, or repair it by `ros2 bag reindex` or `sqlite3 FILE .recover`"


def _store_schema_or_channel(record: McapRecord, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
    match record:
        case Schema():
            schemas[record.id] = record
        case Channel():
            channels[record.id] = record


def _full_type(name: str) -> str:
    """pkg/msg/Name, as ROS 2 writes it; ROS 1 leaves the middle out."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


class _MessageDecoders:
    """Decoders by type: a bag's own definition first, else that of ROS 2, else one of `control_msgs`'s versions."""

    def __init__(self) -> None:
        self._stores: dict[tuple[str, str], list[Any]] = {}

    def decode_message(self, kind: str, encoding: str, data: bytes, text: str, style: str) -> Any:
        """The message's fields. Raises: NotDecodedError."""
        if encoding not in ROS_MESSAGE_ENCODINGS:
            raise NotDecodedError(f"its encoding {encoding!r} is not one of ROS")
        stores = self._stores.get((kind, encoding))
        if stores is None:
            stores = self._stores[kind, encoding] = self._message_type_stores(kind, encoding, text, style)
        why = f"its type {kind} is not known and the bag holds no definition of it"
        for place, store in enumerate(stores):
            try:
                read = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
                message = read(data, kind)
            except Exception as error:  # the decoders are made from the definition and raise what they meet
                why = f"a message does not match its type: {error}"
                continue
            if place:
                self._stores[kind, encoding] = [store, *stores[:place], *stores[place + 1 :]]
            return message
        raise NotDecodedError(why)

    def _message_type_stores(self, kind: str, encoding: str, text: str, style: str) -> list[Any]:
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

        store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
        if text:
            try:
                fresh = get_typestore(Stores.EMPTY)
                if "idl" in style.lower():
                    parts = [part.split("\n", 1)[-1] for part in text.split("=" * 80 + "\n") if part.strip()]
                    for part in parts:
                        fresh.register(get_types_from_idl(part))
                else:
                    fresh.register(get_types_from_msg(text, kind))
                return [fresh] if kind in fresh.fielddefs else []
            except Exception as error:
                raise NotDecodedError(f"its definition in the bag cannot be read: {error}") from error
        if kind in store.fielddefs:
            return [store]
        if kind in EXTRA_MESSAGE_DEFINITIONS:
            for name, definition in EXTRA_MESSAGE_DEFINITIONS.items():
                store.register(get_types_from_msg(definition, name))
            return [store]
        if kind != CONTROLLER_STATE_TYPE:
            return []
        stores = []
        for definition in CONTROLLER_STATE_DEFINITIONS:
            one = get_typestore(Stores.ROS2_HUMBLE)
            one.register(get_types_from_msg(definition, kind))
            stores.append(one)
        return stores
