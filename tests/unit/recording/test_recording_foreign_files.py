"""MCAP files that others wrote, or that were damaged: what can be read is read, and the rest is said."""

from collections.abc import Callable
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2
from mcap.exceptions import McapError
from mcap.writer import CompressionType, Writer

from recording.channels import DEFAULT_ENCODING
from recording.check import check_recording
from recording.foxglove import log_message
from recording.messages import ROW_CODEC_BY_TOPIC
from recording.opening import read_run
from recording.recover import recover
from recording.rows import OdometryRow, Sent
from recording.writer import LOG_TOPIC
from server.api.panel_replay_reading import replay_of

CODEC = ROW_CODEC_BY_TOPIC[Sent.topic]


def sent_channel(writer: Writer) -> int:
    schema = writer.register_schema(CODEC.schema_name, DEFAULT_ENCODING, CODEC.schema)
    return writer.register_channel(Sent.topic, DEFAULT_ENCODING, schema)


def rows(writer: Writer, channel: int, count: int = 300) -> None:
    for number in range(count):
        data = CODEC.encode(Sent(0.01 * number, number, (0.1 * number,) * 6))
        writer.add_message(channel, number, data, number, number)


def made(path: Path, fill: Callable[[Writer], None], compression: CompressionType = CompressionType.NONE) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4096, compression=compression)
        writer.start()
        fill(writer)
        writer.finish()
    return path


def test_a_byte_flipped_in_what_lz4_packed_is_damage(tmp_path: Path) -> None:
    path = made(tmp_path / "lz4.mcap", lambda writer: rows(writer, sent_channel(writer)), CompressionType.LZ4)
    whole = path.read_bytes()
    for place in range(100, len(whole) - 100, len(whole) // 50):
        damaged = bytearray(whole)
        damaged[place] ^= 0x55
        path.write_bytes(damaged)
        assert len(read_run(path).of(Sent)) <= 300


@pytest.mark.parametrize("error", [RuntimeError("LZ4F_decompress failed"), McapError("odd"), EOFError()])
def test_what_the_reader_raises_on_bytes_is_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    path = made(tmp_path / "run.mcap", lambda writer: rows(writer, sent_channel(writer)))

    def broken(*_args: object, **_kwargs: object) -> None:
        raise error

    monkeypatch.setattr("recording.reader.breakup_chunk", broken)
    assert not read_run(path).complete


def without(record_opcode: int, path: Path) -> Path:
    """The same file of plain records, those of one kind left out."""
    whole = path.read_bytes()
    out, at = bytearray(whole[:8]), 8
    while at < len(whole) - 8:
        end = at + 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
        if whole[at] != record_opcode:
            out += whole[at:end]
        at = end
    path.write_bytes(bytes(out) + whole[-8:])
    return path


def plain(path: Path) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, enable_data_crcs=False, enable_crcs=False)
        writer.start()
        rows(writer, sent_channel(writer), 5)
        writer.finish()
    return path


def test_messages_whose_channel_is_missing_are_damage(tmp_path: Path) -> None:
    path = without(0x04, plain(tmp_path / "run.mcap"))
    recording = read_run(path)
    assert not recording.complete
    assert recording.of(Sent) == ()


def test_messages_whose_schema_is_missing_are_saved_but_not_read(tmp_path: Path) -> None:
    path = without(0x03, plain(tmp_path / "run.mcap"))
    recording = read_run(path)
    assert not recording.complete
    assert recording.foreign_channels == ("/sent (protobuf, no schema): 5 messages were not read",)
    saved = recover(path, tmp_path / "saved.mcap")
    assert (saved.n_messages, saved.reason) == (5, "the schema of channel /sent is missing")


def test_what_has_a_channel_is_saved_beside_what_has_none(tmp_path: Path) -> None:
    def both(writer: Writer) -> None:
        rows(writer, sent_channel(writer), 3)
        number = writer.register_channel("/gone", "json", 0)
        writer.add_message(number, 1, b"{}", 1)

    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, enable_data_crcs=False, enable_crcs=False)
        writer.start()
        both(writer)
        writer.finish()
    path.write_bytes(
        path.read_bytes().replace(b"\x04" + (25).to_bytes(8, "little"), b"\x7f" + (25).to_bytes(8, "little"))
    )
    saved = recover(path, tmp_path / "saved.mcap")
    assert (saved.n_messages, saved.was_complete) == (3, False)
    assert saved.reason == "the record of channel 2 is missing"


@pytest.mark.parametrize("encoding", ["json", "cdr", "protobuf"])
@pytest.mark.parametrize("topic", [OdometryRow.topic, LOG_TOPIC])
def test_a_foreign_channel_under_a_known_topic_is_not_decoded_and_said(
    tmp_path: Path, topic: str, encoding: str
) -> None:
    def both(writer: Writer) -> None:
        schema = writer.register_schema("nav_msgs/Odometry", "ros2msg", b"float64 x")
        writer.add_message(writer.register_channel(topic, encoding, schema), 1, b"\xff{}", 1)
        rows(writer, sent_channel(writer), 5)

    path = made(tmp_path / "run.mcap", both)
    recording = read_run(path)
    assert recording.complete
    assert len(recording.of(Sent)) == 5
    message = f"{topic} ({encoding}, schema 'nav_msgs/Odometry'): 1 messages were not read"
    assert recording.foreign_channels == (message,)
    assert f"channel {message}: it is not of this format" in check_recording(path).problems
    assert recover(path, tmp_path / "saved.mcap").n_messages == 6


def test_a_replay_passes_foreign_lines_over(tmp_path: Path) -> None:
    def both(writer: Writer) -> None:
        foreign = writer.register_channel(LOG_TOPIC, "json", 0)
        writer.add_message(foreign, 1, b"{}", 1)
        message = log_message("info", "ours", 5)
        schema = writer.register_schema("foxglove.Log", DEFAULT_ENCODING, b"")
        writer.add_message(
            writer.register_channel(LOG_TOPIC, DEFAULT_ENCODING, schema), 5, message.SerializeToString(), 5
        )

    told, _ = replay_of(made(tmp_path / "run.mcap", both))
    assert [line[-1] for line in told["lines"]] == ["ours"]


def test_a_channel_of_our_name_in_another_layout_is_not_read_as_ours(tmp_path: Path) -> None:
    """A field put in before the others shifts their numbers: its joints would be read as something else."""
    files = descriptor_pb2.FileDescriptorSet.FromString(CODEC.schema)
    for field in files.file[0].message_type[0].field:
        field.number += 1
    longer = descriptor_pb2.FileDescriptorSet.FromString(CODEC.schema)
    longer.file[0].message_type[0].field.add(name="more", number=40, type=1, label=1)

    def channel(writer: Writer, schema: bytes) -> int:
        return writer.register_channel(
            Sent.topic, DEFAULT_ENCODING, writer.register_schema(CODEC.schema_name, DEFAULT_ENCODING, schema)
        )

    other = made(tmp_path / "other.mcap", lambda writer: rows(writer, channel(writer, files.SerializeToString()), 30))
    found = read_run(other)
    assert not found.of(Sent)
    assert found.foreign_channels == (
        f"{Sent.topic} (protobuf, schema '{CODEC.schema_name}' of another layout): 30 messages were not read",
    )
    newer = made(tmp_path / "newer.mcap", lambda writer: rows(writer, channel(writer, longer.SerializeToString()), 30))
    assert len(read_run(newer).of(Sent)) == 30
    broken = made(tmp_path / "broken.mcap", lambda writer: rows(writer, channel(writer, b"\xff\xff"), 30))
    assert not read_run(broken).of(Sent)
