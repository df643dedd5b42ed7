"""A live recording beside a disk that is slow or full, and rows that no file can hold."""

import threading
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader
from written_runs import SECOND_NS, plc_state

from recording.opening import read_run
from recording.rows import PlcState
from recording.run import RunInfo
from recording.writer import QUEUED_IMAGES_MAX, RunWriter


def hold_up(writer: RunWriter, until: threading.Event) -> None:
    write = writer._writer.add_message

    def late(*args: object, **kwargs: object) -> None:
        until.wait(30.0)
        write(*args, **kwargs)  # pyright: ignore[reportArgumentType]

    writer._writer.add_message = late  # pyright: ignore[reportAttributeAccessIssue]


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
    assert recording.n_images == 200 - report.images_dropped >= QUEUED_IMAGES_MAX
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
    monkeypatch.setattr("recording.writer.QUEUE_ENTRIES_MAX", 20)
    writer = RunWriter(tmp_path / "run.mcap", RunInfo("odd"), patient=True)
    for number in range(300):  # of more rows than the queue holds
        writer.row(replace(plc_state(number), seq_received=2**64 - 1 if number == 10 else number), SECOND_NS)
    report = writer.close()
    assert "channel /plc: seq_received = 18446744073709551615 cannot be written" in report.error
    assert report.n_messages == 10
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
    monkeypatch.setattr("recording.writer.QUEUE_ENTRIES_MAX", 5)
    writer, stalled = RunWriter(tmp_path / "run.mcap", RunInfo("stalled")), threading.Event()
    hold_up(writer, stalled)
    for number in range(20):
        writer.row(plc_state(number), SECOND_NS)
    assert "5 entries wait for the disk, and no more are accepted" in writer.error
    stalled.set()
    assert "wait for the disk" in writer.close().error


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_nobody_waits_for_a_thread_that_has_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recording.writer.QUEUE_ENTRIES_MAX", 2)
    writer = RunWriter(tmp_path / "run.mcap", RunInfo("odd"), patient=True)

    def ended(*_args: object, **_kwargs: object) -> None:
        raise SystemExit

    writer._writer.add_message = ended  # pyright: ignore[reportAttributeAccessIssue]
    writer.row(plc_state(0), SECOND_NS)
    writer._thread.join()
    for number in range(4):
        writer.row(plc_state(number), SECOND_NS)
    assert "the writer thread has ended" in writer.close().error


def test_a_disk_that_is_late_holds_the_closing_no_longer_than_asked(tmp_path: Path) -> None:
    writer, stalled = RunWriter(tmp_path / "run.mcap", RunInfo("late")), threading.Event()
    hold_up(writer, stalled)
    for number in range(3):
        writer.row(plc_state(number), SECOND_NS + number)
    report = writer.close(RunInfo("late", seed=5), wait_s=0.05)
    assert "the disk has not taken all of it within 0.05 s" in report.error
    assert (writer.has_ended, writer.error) == (False, "")
    writer.row(plc_state(3), SECOND_NS)  # belongs to no run any more
    stalled.set()
    assert writer.close().error == ""
    recording = read_run(tmp_path / "run.mcap")
    assert (recording.complete, recording.run_info.seed, len(recording.of(PlcState))) == (True, 5, 3)


def test_a_full_queue_does_not_hold_up_the_closing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recording.writer.QUEUE_ENTRIES_MAX", 2)
    writer, stalled = RunWriter(tmp_path / "run.mcap", RunInfo("late")), threading.Event()
    hold_up(writer, stalled)
    for number in range(10):
        writer.row(plc_state(number), SECOND_NS + number)
    assert "2 entries wait for the disk" in writer.close(wait_s=0.05).error
    stalled.set()
    writer.close()
    assert writer.has_ended
