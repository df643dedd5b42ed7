"""Recordings cut short, damaged, or of a process that was killed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from written_runs import MACHINE_TOML, ROOT, write

from recording.check import check_recording
from recording.convert import convert
from recording.errors import RecordingError
from recording.opening import read_run
from recording.recover import recover
from recording.rows import Sent

CHUNK = 0x06  # MCAP's opcode


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


def test_one_wrong_byte_costs_one_chunk_and_what_was_saved_says_so(tmp_path: Path) -> None:
    whole = bytearray(write(tmp_path / "whole.mcap", 15_000).read_bytes())
    chunks, at = [], 8
    while at < len(whole) - 8:
        length = int.from_bytes(whole[at + 1 : at + 9], "little")
        chunks += [(at, length)] if whole[at] == CHUNK else []
        at += 9 + length
    assert len(chunks) > 5
    start, length = chunks[len(chunks) // 2]
    whole[start + 9 + length // 2] ^= 0x55
    path = tmp_path / "damaged.mcap"
    path.write_bytes(whole)
    found = read_run(path)
    assert not found.complete
    assert len(found.rows) > 33_000 * (1.0 - 3.0 / len(chunks))
    assert found.run_info.segments, "what was written last is there"
    report = recover(path, tmp_path / "saved.mcap")
    assert report.lost_chunks == 1
    assert len(read_run(tmp_path / "saved.mcap").rows) == len(found.rows)
    assert "1 chunks lost" in " ".join(check_recording(tmp_path / "saved.mcap").problems)


def test_what_is_made_of_a_cut_file_says_so_in_either_form(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.mcap", 3000).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    convert(tmp_path / "cut.mcap", tmp_path / "folder")
    convert(tmp_path / "folder", tmp_path / "again.mcap")
    for name in ("folder", "again.mcap"):
        assert not read_run(tmp_path / name).complete
        assert "made of a cut" in " ".join(check_recording(tmp_path / name).problems)
    with pytest.raises(RecordingError, match="is MCAP already"):
        convert(tmp_path / "again.mcap", tmp_path / "third.mcap")


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
