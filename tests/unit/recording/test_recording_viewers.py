"""What viewers need: every schema read by Foxglove's own library, a layout that fits, and Rerun without loss."""

import importlib.util
import json
import re
from dataclasses import fields
from pathlib import Path
from typing import get_type_hints

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf import CameraCalibration_pb2, CompressedImage_pb2, FrameTransforms_pb2, Log_pb2
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rerun_arrivals import Arrival, arrivals

from longreach.rerun_view import RerunError, convert, write_blueprint
from machine.description import parse_machine_toml
from recording.content import Attachment
from recording.foxglove import FramePose
from recording.messages import ROW_CODEC_BY_TOPIC
from recording.rows import ROW_TYPES, Floats
from recording.run import RunInfo
from recording.writer import CALIBRATION_TOPIC, IMAGE_TOPIC, LOG_TOPIC, TRANSFORM_TOPIC, RunWriter

ROOT = Path(__file__).parents[3]
MACHINE_TOML = (ROOT / "machine" / "machines" / "hiab033.toml").read_bytes()
LAYOUT = ROOT / "recording" / "viewers" / "foxglove-layout.json"
N = 4
FOXGLOVE = {
    IMAGE_TOPIC: CompressedImage_pb2.CompressedImage,
    CALIBRATION_TOPIC: CameraCalibration_pb2.CameraCalibration,
    TRANSFORM_TOPIC: FrameTransforms_pb2.FrameTransforms,
    LOG_TOPIC: Log_pb2.Log,
}
needs_rerun = pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed")


def value(hint, number):
    if hint is Floats or hint == Floats:
        return (0.5 * number, -2.0, 3.25)
    return {float: 1.5 * number + 0.1, int: 7 + number, str: f"wörd {number}", bool: bool(number % 2)}[hint]


def a_row(row_type, number):
    hints = get_type_hints(row_type)
    return row_type(**{field.name: value(hints[field.name], number) for field in fields(row_type)})


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """A recording with messages on every channel there is."""
    path = tmp_path_factory.mktemp("recorded") / "all.mcap"
    attachments = [Attachment("machine.toml", "application/toml", MACHINE_TOML)]
    info = RunInfo("all", "2026-01-02T03:04:05+00:00", 7, 0.0, 0.0, 1.7e9, ())
    writer = RunWriter(path, info, attachments, [("seed", "7")], mono_to_utc_ns=1_700_000_000 * 10**9)
    camera = parse_machine_toml(MACHINE_TOML.decode()).camera
    for number in range(N):
        t_ns = 10**9 + number * 10**8
        for row_type in ROW_TYPES:
            writer.row(a_row(row_type, number), t_ns, t_ns - 1000)
        good, jpeg = cv2.imencode(".jpg", np.full((36, 64, 3), 40 * number, np.uint8))
        assert good
        assert writer.image(jpeg.tobytes(), t_ns, t_ns)
        writer.camera(camera, 64, t_ns)
        lift = FramePose("base", "link_1", (1.0, 2.0, 3.0 + number / 3), (0.8, 0.0, 0.6, 0.0))
        writer.transforms([lift, FramePose("link_1", "cam_left", (0.0, 0.1, 0.5), (1.0, 0.0, 0.0, 0.0))], t_ns)
        writer.log("warning", f"careful {number}", t_ns)
    assert writer.close(info).error == ""
    return path


def test_foxgloves_library_reads_every_schema_and_every_value(recorded):
    seen = {}
    with recorded.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, _, message in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            seen.setdefault(channel.topic, []).append(message)
    assert set(seen) == {row_type.topic for row_type in ROW_TYPES} | set(FOXGLOVE)
    for row_type in ROW_TYPES:
        for number, message in enumerate(seen[row_type.topic]):
            for name, wanted in ((one.name, getattr(a_row(row_type, number), one.name)) for one in fields(row_type)):
                got = getattr(message, name)
                assert (tuple(got) if isinstance(wanted, tuple) else got) == wanted, f"{row_type.topic}.{name}"


def test_the_well_known_schemas_are_foxgloves_own(recorded):
    with recorded.open("rb") as file:
        summary = make_reader(file).get_summary()
    for topic, message in FOXGLOVE.items():
        channel = next(one for one in summary.channels.values() if one.topic == topic)
        schema = summary.schemas[channel.schema_id]
        assert schema.name == message.DESCRIPTOR.full_name
        files = {one.name: one for one in FileDescriptorSet.FromString(schema.data).file}
        assert files[message.DESCRIPTOR.file.name].SerializeToString() == message.DESCRIPTOR.file.serialized_pb


def test_the_layout_names_only_topics_and_fields_that_there_are():
    text = LAYOUT.read_text(encoding="utf-8")
    topics = set(re.findall(r'"(/[a-z_/]+)[."\[]', text))
    assert {"/plc", "/camera/left", "/log"} <= topics <= set(ROW_CODEC_BY_TOPIC) | set(FOXGLOVE)
    names = set(re.findall(r'"/plc\.([a-z_]+)\[', text))
    assert names
    assert names <= {field.name for field in fields(ROW_CODEC_BY_TOPIC["/plc"].row_type)}
    layout = json.loads(text)
    placed = set(re.findall(r'"([A-Za-z0-9]+![a-z]+)"', json.dumps(layout["layout"])))
    assert placed == set(layout["configById"])


def test_a_channel_that_lost_anything_is_not_whole():
    assert Arrival("/plc", "", 5, 5, 5, "").whole
    assert not Arrival("/plc", "", 5, 5, 4, "").whole
    assert not Arrival("/plc", "", 5, 4, 4, "").whole
    assert not Arrival("/plc", "", 5, 6, 5, "").whole


@needs_rerun
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of a library that is not ours
def test_everything_arrives_in_rerun(recorded, tmp_path):
    found = {one.topic: one for one in arrivals(recorded, tmp_path / "all.rrd")}
    assert set(found) == {row_type.topic for row_type in ROW_TYPES} | set(FOXGLOVE) | {"attachments"}
    assert [one for one in found.values() if not one.whole] == []
    assert found[TRANSFORM_TOPIC].written == 2 * N
    write_blueprint(tmp_path / "all.rbl")
    assert (tmp_path / "all.rbl").stat().st_size > 0


@needs_rerun
@pytest.mark.slow
def test_what_is_no_recording_is_refused_by_name(tmp_path):
    (tmp_path / "no.mcap").write_bytes(b"nothing")
    with pytest.raises(RerunError, match=r"no\.mcap"):
        convert(tmp_path / "no.mcap", tmp_path / "no.rrd")
