"""Writing a run, and reading it back."""

import threading
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from written_runs import MACHINE_TOML, plc_state, run_info, same, write

from recording.check import check_recording
from recording.content import column
from recording.errors import RecordingError
from recording.messages import ROW_CODEC_BY_TOPIC
from recording.opening import read_run
from recording.rows import ROW_TYPES, CameraState, PlcState, Row
from recording.run import RunInfo, run_from_toml, run_to_toml
from recording.writer import RunWriter


@pytest.mark.parametrize("row_type", ROW_TYPES)
def test_every_row_survives_protobuf(row_type: type[Row]) -> None:
    kinds = {"float": -1.5, "int": -(2**40), "str": "grün", "bool": True}
    hints = {each.name: str(each.type) for each in fields(row_type)}
    values = {}
    for name in hints:
        hint = row_type.__annotations__[name]
        base = getattr(hint, "__origin__", hint) if hasattr(hint, "__metadata__") else hint
        values[name] = kinds.get(getattr(base, "__name__", ""), (0.1, -2.0, 3e300))
    values = {name: (0.1, -2.0) if base_is_floats(row_type, name) else values[name] for name in values}
    row = row_type(**values)
    codec = ROW_CODEC_BY_TOPIC[row_type.topic]
    assert codec.decode(codec.encode(row)) == row


def base_is_floats(row_type: type[Row], name: str) -> bool:
    return "tuple" in str(row_type.__annotations__[name])


def test_written_run_reads_back(tmp_path: Path) -> None:
    recording = read_run(write(tmp_path / "run.mcap"))
    assert recording.complete
    assert recording.run_info == run_info()
    assert recording.machine_toml == MACHINE_TOML
    assert len(recording.of(PlcState)) == 100
    assert same(recording.of(PlcState)[42], plc_state(42))
    assert recording.n_images == 10
    assert [(entry.level, entry.text) for entry in recording.log_entries] == [("warning", "careful")]
    assert ("longreach.seed", "7") in recording.metadata
    q = column(recording.of(PlcState), "q_rad")
    assert q.shape == (100, 6)
    np.testing.assert_allclose(q[3], np.arange(6) * 0.1 + 3e-3, atol=1e-15)


def test_an_independent_reader_finds_schemas_and_index(tmp_path: Path) -> None:
    with write(tmp_path / "run.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        names = {schema.name for schema in summary.schemas.values()}
        assert {"foxglove.CompressedImage", "foxglove.Log", "foxglove.FrameTransforms", "longreach.PlcState"} <= names
        assert {schema.encoding for schema in summary.schemas.values()} == {"protobuf"}
        messages = list(reader.iter_decoded_messages(topics=["/plc"]))
        assert len(messages) == 100
        assert messages[5].decoded_message.t_plc_s == pytest.approx(100.05, abs=1e-12)
        assert messages[5].message.log_time - messages[5].message.publish_time == 1000
        assert {attachment.name for attachment in reader.iter_attachments()} == {"run.toml", "machine.toml"}


def test_check_of_a_full_recording(tmp_path: Path) -> None:
    report = check_recording(write(tmp_path / "run.mcap"))
    assert report.usable
    assert report.problems == ()
    signals = {signal.name: signal for signal in report.signals}
    assert signals["plc"].rate_hz == pytest.approx(100.0, rel=1e-6)
    assert signals["plc"].n_gaps == 0
    assert {missing.signal for missing in report.missing_signals} == {"tracker.csv or static.csv"}


def test_rows_without_csv_form_stay_in_mcap() -> None:
    assert CameraState.file == ""
    assert CameraState.topic in ROW_CODEC_BY_TOPIC


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", 2)
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="File exists"):
        RunWriter(path, RunInfo("x"))
    assert path.read_bytes() == before


def test_a_file_that_cannot_be_made_leaves_no_thread(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    before = threading.active_count()
    for _ in range(10):
        with pytest.raises(RecordingError, match="choose a folder"):
            RunWriter(tmp_path / "file" / "run.mcap", RunInfo("x"))
    until_s = time.monotonic() + 20.0
    while threading.active_count() > before and time.monotonic() < until_s:
        time.sleep(0.05)
    assert threading.active_count() <= before


@pytest.mark.parametrize("name", ["Kran \U0001f3d7", "a\x7fb", 'quote " \\ \n \x01'])
def test_a_run_of_any_name_is_read_back(name: str) -> None:
    assert run_from_toml(run_to_toml(RunInfo(name))).name == name
