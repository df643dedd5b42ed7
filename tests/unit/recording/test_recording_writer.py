"""Writing, reading, cutting, recovering and converting recordings."""

import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recording.check import check_recording
from recording.content import Attachment, Recording, column
from recording.convert import convert, write_mcap
from recording.errors import RecordingError
from recording.folder import write_folder
from recording.foxglove import FramePose
from recording.messages import CODECS
from recording.opening import read_run
from recording.recover import recover
from recording.rows import NAN, ROW_TYPES, CameraState, Floats, MarkerCorners, OdometryRow, PlcState, Row, Sent
from recording.run import RunInfo, Segment
from recording.writer import IMAGES_MAX, RunWriter

ROOT = Path(__file__).parents[3]
MACHINE_TOML = (ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")
SECOND_NS = 1_000_000_000


def plc_state(number: int) -> PlcState:
    joints: Floats = tuple(0.1 * joint + 1e-3 * number for joint in range(6))
    return PlcState(
        t_plc_s=100.0 + 0.01 * number,
        seq_received=number,
        q_ref_rad=joints,
        qd_ref_rad_s=joints,
        q_rad=joints,
        u_frac=joints,
        p_a_pa=joints,
        p_b_pa=joints,
        p_supply_pa=2.1e7,
        t_oil_c=NAN,
        plc_state="ARMED",
    )


def run_info() -> RunInfo:
    segments = (Segment("a", "repeat", 100.0, 100.5, "a"), Segment("b", "hold", 100.5, 101.0))
    return RunInfo('quote " and ä', "2026-01-02T03:04:05+00:00", 7, -95.5, 12.25, 1.7e9, segments)


def write(path: Path, count: int = 100) -> Path:
    attachments = [Attachment("machine.toml", "application/toml", MACHINE_TOML.encode())]
    writer = RunWriter(path, run_info(), attachments, [("seed", "7")])
    corners = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.5)
    for number in range(count):
        t_ns = SECOND_NS + number * 10_000_000
        writer.row(plc_state(number), t_ns, t_ns - 1000)
        writer.row(Sent(4.0 + 0.01 * number, number, (0.0,) * 6), t_ns)
        if number % 10 == 0:
            writer.row(MarkerCorners(0.01 * number, "left", 10, *corners), t_ns)
            writer.row(OdometryRow(0.01 * number, 0.0, 0.1, 0.2, 1.0, 0.0, 0.0, 0.0, "ok", 120), t_ns)
            writer.image(b"jpeg" * 100, t_ns, t_ns)
    writer.log("warning", "careful", SECOND_NS)
    writer.transforms([FramePose("base", "tcp", (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))], SECOND_NS)
    report = writer.close(run_info())
    assert report.error == ""
    assert report.images_dropped == 0 or count > 10 * IMAGES_MAX
    return path


def same(first: Row, second: Row) -> bool:
    pairs = [(getattr(first, each.name), getattr(second, each.name)) for each in fields(first)]
    return all(a == b or (a != a and b != b) for a, b in pairs)


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
    codec = CODECS[row_type.topic]
    assert codec.decode(codec.encode(row)) == row


def base_is_floats(row_type: type[Row], name: str) -> bool:
    return "tuple" in str(row_type.__annotations__[name])


def test_written_run_reads_back(tmp_path: Path) -> None:
    recording = read_run(write(tmp_path / "run.mcap"))
    assert recording.complete
    assert recording.run == run_info()
    assert recording.machine_toml == MACHINE_TOML
    assert len(recording.of(PlcState)) == 100
    assert same(recording.of(PlcState)[42], plc_state(42))
    assert recording.images == 10
    assert [(entry.level, entry.text) for entry in recording.log] == [("warning", "careful")]
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


def test_folder_and_back_keeps_every_csv_number(tmp_path: Path) -> None:
    source = write(tmp_path / "run.mcap")
    convert(source, tmp_path / "folder")
    header = (tmp_path / "folder" / "plc.csv").read_text().splitlines()[0].split(",")
    assert header[:4] == ["t_plc_s", "seq_received", "q_ref_1_rad", "q_ref_2_rad"]
    assert header[-3:] == ["p_supply_pa", "t_oil_c", "t_receive_pc_s"]
    assert "u_6_frac" in header
    assert (tmp_path / "folder" / "machine.toml").read_text() == MACHINE_TOML
    convert(tmp_path / "folder", tmp_path / "again.mcap")
    first, again = read_run(source), read_run(tmp_path / "again.mcap")
    assert again.run == first.run
    for row_type in (PlcState, Sent, MarkerCorners, OdometryRow):
        assert len(again.of(row_type)) == len(first.of(row_type))
    for name in ("t_plc_s", "seq_received", "q_ref_rad", "q_rad", "u_frac", "p_a_pa", "p_supply_pa", "t_oil_c"):
        np.testing.assert_array_equal(column(again.of(PlcState), name), column(first.of(PlcState), name))
    assert same(again.of(MarkerCorners)[3], first.of(MarkerCorners)[3])


def test_converting_over_something_is_refused(tmp_path: Path) -> None:
    source = write(tmp_path / "run.mcap", 3)
    with pytest.raises(RecordingError, match="exists already"):
        convert(source, source)


def test_a_foreign_folder_with_few_columns(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("[run]\nname = 'x'\noperator = 'unknown key'\n")
    (tmp_path / "plc.csv").write_text("q_2_rad,t_plc_s,q_1_rad,extra\n0.2,1.0,0.1,z\n,1.1,,\n\n")
    recording = read_run(tmp_path)
    rows = recording.of(PlcState)
    assert rows[0].q_rad == (0.1, 0.2)
    assert rows[1].q_rad == ()
    assert rows[0].seq_received == -1
    assert math.isnan(rows[0].p_supply_pa)
    report = check_recording(tmp_path)
    lacking = {lack.signal for lack in report.lacks}
    assert {"sent.csv", "plc.csv u", "machine.toml"} <= lacking
    assert "plc.csv q" not in lacking
    assert not report.usable


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("t_plc_s,q_1_rad\n1.0,0\n2.0,0,5\n", "line 3: 3 cells under 2 column names"),
        ("t_plc_s,q_1_rad\n1.0,0,\nx,1\n", "line 3.*'x' is not a number"),
        ("t_plc_s,q_1_rad,q_3_rad\n1.0,0,5\n", r"joints \[1, 3\]"),
        ("time,q_1_rad\n1.0,0\n", "column 't_plc_s' is missing"),
        (
            "t_plc_s,q_1_rad,q_2_rad,q_1_rad\n1.0,0,1,2\n",
            r"plc\.csv: column 'q_1_rad' is there twice \(columns 2 and 4 of the file\)",
        ),
        (
            "t_plc_s,q_1_rad,q_01_rad\n1.0,0,1\n",
            r"column 'q_1_rad' is there twice, as 'q_1_rad' and as 'q_01_rad' \(columns 2 and 3",
        ),
        (
            "t_plc_s,p_supply_pa,q_1_rad,p_supply_pa\n1.0,0,1,2\n",
            r"column 'p_supply_pa' is there twice \(columns 2 and 4",
        ),
        ("t_plc_s,q_1_rad,q_1_m\n1.0,0,1\n", r"'q_1_m' is there in two units \(columns 2 and 3"),
    ],
)
def test_bad_csv_names_the_place(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "run.toml").write_text("[run]\nname = 'x'\n")
    (tmp_path / "plc.csv").write_text(text)
    with pytest.raises(RecordingError, match=match):
        read_run(tmp_path)


def test_a_file_cut_anywhere_is_readable_and_recoverable(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.mcap", 3000).read_bytes()
    rows_before = 0
    for fraction in (0.3, 0.6, 0.9, 0.999):
        cut = tmp_path / f"cut{fraction}.mcap"
        cut.write_bytes(whole[: int(len(whole) * fraction)])
        recording = read_run(cut)
        assert not recording.complete
        assert recording.machine_toml == MACHINE_TOML
        assert len(recording.rows) >= rows_before
        rows_before = len(recording.rows)
        mended = tmp_path / f"mended{fraction}.mcap"
        report = recover(cut, mended)
        assert not report.was_complete
        assert read_run(mended).complete
        assert len(read_run(mended).rows) == len(recording.rows)
    assert rows_before > 1000


def test_garbage_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"not a recording at all, but long enough to look at")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        read_run(path)
    with pytest.raises(RecordingError):
        recover(path, tmp_path / "y.mcap")
    assert not (tmp_path / "y.mcap").exists()


def test_random_damage_gives_rows_or_recording_error(tmp_path: Path) -> None:
    whole = bytearray(write(tmp_path / "whole.mcap", 300).read_bytes())
    rng = np.random.default_rng(4)
    path = tmp_path / "damaged.mcap"
    for _ in range(60):
        damaged = bytearray(whole)
        for place in rng.integers(8, len(whole), 5):
            damaged[place] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            recording = read_run(path)
        except RecordingError:
            continue
        assert len(recording.rows) <= 662


def test_a_chunk_of_an_impossible_size_is_damage(tmp_path: Path) -> None:
    whole = bytearray(write(tmp_path / "whole.mcap", 300).read_bytes())
    at, chunk_opcode = 8, 0x06
    while whole[at] != chunk_opcode:
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    whole[at + 25 : at + 33] = (2**63 + 1).to_bytes(8, "little")  # behind opcode, length, first and last log time
    path = tmp_path / "damaged.mcap"
    path.write_bytes(whole)
    assert not read_run(path).complete


def test_an_infinite_count_in_a_folder_is_named(tmp_path: Path) -> None:
    write_folder(read_run(write(tmp_path / "whole.mcap", 3)), tmp_path / "run")
    path = tmp_path / "run" / "sent.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    column = lines[0].split(",").index("seq")
    cells = lines[1].split(",")
    cells[column] = "inf"
    path.write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"sent\.csv.*'inf' is no count"):
        read_run(tmp_path / "run")


def test_a_killed_writer_leaves_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    code = f"""
import sys, time
sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
from recording.rows import Sent
from recording.run import RunInfo
from recording.writer import RunWriter
writer = RunWriter(Path({str(path)!r}), RunInfo("killed"))
for number in range(100000):
    writer.row(Sent(number * 0.001, number, (0.0,) * 6), time.monotonic_ns())
    time.sleep(0.001)
    if number == 1500: print("now", flush=True)
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"now\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    recording = read_run(path)
    assert not recording.complete
    assert len(recording.of(Sent)) > 300  # all but the last second


def test_images_give_way_to_numbers(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "run.mcap", RunInfo("pressure"))
    release = writer._writer.add_message  # hold the writer up by a slow disk

    def slow(*args: object, **kwargs: object) -> None:
        import time

        time.sleep(2e-3)
        release(*args, **kwargs)  # pyright: ignore[reportArgumentType]

    writer._writer.add_message = slow  # pyright: ignore[reportAttributeAccessIssue]
    for number in range(200):
        writer.image(b"x" * 1000, SECOND_NS + number, SECOND_NS + number)
        writer.row(plc_state(number), SECOND_NS + number)
    report = writer.close()
    recording = read_run(tmp_path / "run.mcap")
    assert len(recording.of(PlcState)) == 200
    assert report.images_dropped > 0
    assert recording.images == 200 - report.images_dropped >= IMAGES_MAX
    assert ("longreach/end.images_dropped", str(report.images_dropped)) in recording.metadata


def test_a_full_disk_is_told_and_blocks_nobody(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "run.mcap", RunInfo("full"))

    def full(*_args: object, **_kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    writer._writer.add_message = full  # pyright: ignore[reportAttributeAccessIssue]
    writer.row(plc_state(0), SECOND_NS)
    report = writer.close()
    assert "No space left" in report.error


def test_a_row_that_cannot_be_written_ends_the_file_and_blocks_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recording.writer.QUEUE_ENTRIES", 20)
    writer = RunWriter(tmp_path / "run.mcap", RunInfo("odd"), patient=True)
    for number in range(300):  # of more rows than the queue holds
        writer.row(replace(plc_state(number), seq_received=2**64 - 1 if number == 10 else number), SECOND_NS)
    report = writer.close()
    assert "channel /plc: seq_received = 18446744073709551615 cannot be written" in report.error
    assert report.messages == 10
    assert not read_run(tmp_path / "run.mcap").complete


def test_a_log_time_that_no_file_holds_is_told(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "run.mcap", RunInfo("odd"), mono_to_utc_ns=-1000 * SECOND_NS)
    writer.row(plc_state(0), SECOND_NS)
    assert "channel /plc: log time -999000000000 ns is outside 0 .. 18446744073709551615 ns" in writer.close().error


def test_a_source_stamp_that_no_file_holds_is_not_known(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "run.mcap", RunInfo("odd"), mono_to_utc_ns=0)
    writer.row(plc_state(0), SECOND_NS, -5)
    writer.row(plc_state(1), SECOND_NS, 2**64)
    assert writer.close().error == ""
    with (tmp_path / "run.mcap").open("rb") as stream:
        messages = [message for _, _, message in make_reader(stream).iter_messages()]
    assert [(one.log_time, one.publish_time) for one in messages] == [(SECOND_NS, SECOND_NS)] * 2


def test_a_live_recording_never_waits_for_its_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recording.writer.QUEUE_ENTRIES", 5)
    writer, stalled = RunWriter(tmp_path / "run.mcap", RunInfo("stalled")), threading.Event()
    write = writer._writer.add_message

    def late(*args: object, **kwargs: object) -> None:
        stalled.wait(30.0)
        write(*args, **kwargs)  # pyright: ignore[reportArgumentType]

    writer._writer.add_message = late  # pyright: ignore[reportAttributeAccessIssue]
    for number in range(20):
        writer.row(plc_state(number), SECOND_NS)
    assert "5 entries wait for the disk, and no more are taken" in writer.error
    stalled.set()
    assert "wait for the disk" in writer.close().error


def test_nobody_waits_for_a_thread_that_has_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recording.writer.QUEUE_ENTRIES", 2)
    writer = RunWriter(tmp_path / "run.mcap", RunInfo("odd"), patient=True)
    writer._queue.put(None)
    writer._thread.join()
    for number in range(4):
        writer.row(plc_state(number), SECOND_NS)
    assert "the thread that writes it has ended" in writer.close().error


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda row: replace(row, seq_received=2**64 - 1), "seq_received = 18446744073709551615, limits"),
        (lambda row: replace(row, t_plc_s=1e30), r"its time is 1e\+30 s in UTC, limits 0 to"),
    ],
)
def test_a_row_that_mcap_cannot_hold_is_named_and_nothing_is_written(
    tmp_path: Path, spoil: Callable[[PlcState], PlcState], told: str
) -> None:
    rows = [plc_state(number) for number in range(300)]
    rows[9] = spoil(rows[9])
    write_folder(Recording("folder", RunInfo("odd"), "", tuple(rows)), tmp_path / "run")
    with pytest.raises(RecordingError, match=rf"plc\.csv, row 10: {told}"):
        convert(tmp_path / "run", tmp_path / "run.mcap")
    assert not (tmp_path / "run.mcap").exists()


def test_an_offset_before_all_time_is_named(tmp_path: Path) -> None:
    run = RunInfo("odd", pc_to_utc_offset_s=-1000.0)
    with pytest.raises(RecordingError, match=r"plc\.csv, row 1: its time is -900 s in UTC.*mend .* \[clocks\]"):
        write_mcap(Recording("folder", run, "", (plc_state(0),)), tmp_path / "run.mcap")


def test_a_file_that_broke_off_is_no_conversion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_args: object, **_kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("recording.writer.McapWriter.add_message", full)
    with pytest.raises(RecordingError, match="No space left"):
        write_mcap(Recording("folder", RunInfo("full"), "", (plc_state(0),)), tmp_path / "run.mcap")
    assert not (tmp_path / "run.mcap").exists()


def test_check_of_a_full_recording(tmp_path: Path) -> None:
    report = check_recording(write(tmp_path / "run.mcap"))
    assert report.usable
    assert report.problems == ()
    signals = {signal.name: signal for signal in report.signals}
    assert signals["plc"].rate_hz == pytest.approx(100.0, rel=1e-6)
    assert signals["plc"].gaps == 0
    assert {lack.signal for lack in report.lacks} == {"tracker.csv or static.csv"}


def test_rows_without_csv_form_stay_in_mcap() -> None:
    assert CameraState.file == ""
    assert CameraState.topic in CODECS


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", 2)
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="File exists"):
        RunWriter(path, RunInfo("x"))
    assert path.read_bytes() == before
