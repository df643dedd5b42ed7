"""MCAP <-> folder of CSV files."""

import heapq
import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_type_hints

from recording.content import Attachment, Recording
from recording.errors import RecordingError
from recording.folder import write_folder
from recording.opening import read_run
from recording.rows import Row
from recording.run import RunInfo
from recording.writer import MCAP_TIME_MAX_NS, RECOVERABLE_ROWS_HINT, RunWriter

COUNT_LEAST, COUNT_MOST = -(2**63), 2**63 - 1  # what the messages' counts hold
CLOCK_REMEDY = "fix the row's time, or [clocks] of run.toml"


def convert(source: Path, target: Path) -> Recording:
    """Write the other form of `source`: a target named *.mcap becomes MCAP, any other a folder. Returns what was read.

    Raises: RecordingError when the source cannot be read, or the target exists already.
    """
    if target.exists():
        raise RecordingError(f"{target} exists already; choose another name")
    recording = read_run(source)
    if target.suffix == ".mcap" and recording.storage_format == "mcap":
        raise RecordingError(f"{source} is MCAP already; `longreach recording recover` copies one with its pictures")
    recording = replace(recording, run_info=replace(recording.run_info, cut=not recording.complete))
    if target.suffix == ".mcap":
        write_mcap(recording, target)
    else:
        write_folder(recording, target)
    return recording


def write_mcap(recording: Recording, path: Path) -> None:
    """Write a recording's numbers as MCAP. Times become UTC by the run's clock offsets, as far as they are known.

    Raises: RecordingError: a count or a time that MCAP cannot hold, naming the row; a file that cannot be written.
    """
    to_utc_ns = round((recording.run_info.pc_to_utc_offset_s or 0.0) * 1e9)
    _require_room(recording, to_utc_ns)
    attachments = [*recording.attachments]
    if recording.machine_toml:
        attachments.insert(0, Attachment("machine.toml", "application/toml", recording.machine_toml.encode()))
    writer = RunWriter(
        path, recording.run_info, attachments, recording.metadata, mono_to_utc_ns=to_utc_ns, patient=True
    )
    for entry in recording.log_entries:
        writer.log(entry.level, entry.text, entry.t_utc_ns - to_utc_ns)
    for t_ns, row in _in_turn(recording):
        writer.row(row, t_ns)
    report = writer.close(recording.run_info)
    if report.error:
        path.unlink(missing_ok=True)  # the source holds all of it
        raise RecordingError(report.error.removesuffix(f"; {RECOVERABLE_ROWS_HINT}"))


def _require_room(recording: Recording, to_utc_ns: int) -> None:
    """Every count and time has to fit, before anything is written."""
    counts = {row_type: _integer_field_names(row_type) for row_type in {type(row) for row in recording.rows}}
    numbers: Counter[type[Row]] = Counter()
    for row in recording.rows:
        kind = type(row)
        numbers[kind] += 1
        for name in counts[kind]:
            if not COUNT_LEAST <= getattr(row, name) <= COUNT_MOST:
                fault = f"{name} = {getattr(row, name)}, limits {COUNT_LEAST} to {COUNT_MOST}"
                raise RecordingError(
                    f"{_row_location(recording, kind, numbers[kind])}: {fault}; leave the cell empty without a value"
                )
        t_utc_ns = pc_time_ns(row, recording.run_info) + to_utc_ns
        if not 0 <= t_utc_ns <= MCAP_TIME_MAX_NS:
            fault = (
                f"its time is {t_utc_ns * 1e-9:.6g} s in UTC, limits 0 to {MCAP_TIME_MAX_NS * 1e-9:.6g} s since 1970"
            )
            raise RecordingError(f"{_row_location(recording, kind, numbers[kind])}: {fault}; {CLOCK_REMEDY}")


def _integer_field_names(row_type: type[Row]) -> list[str]:
    return [name for name, kind in get_type_hints(row_type).items() if kind is int]


def _row_location(recording: Recording, kind: type[Row], number: int) -> str:
    return f"{kind.file if recording.storage_format == 'folder' else kind.topic}, row {number}"


def _in_turn(recording: Recording) -> Iterator[tuple[int, Row]]:
    """All rows with their time on the PC's clock: kinds take turns as while recording, each in its own order.

    Why: a file that is cut or damaged then holds something of every kind up to there.
    """
    by_kind: dict[type[Row], list[tuple[int, int, Row]]] = {}
    for number, row in enumerate(recording.rows):
        by_kind.setdefault(type(row), []).append((pc_time_ns(row, recording.run_info), number, row))
    turns = []
    for rows in by_kind.values():
        reached = itertools.accumulate((t_ns for t_ns, _, _ in rows), max)  # a clock that jumps back keeps its place
        turns.append([(turn, *row) for turn, row in zip(reached, rows, strict=True)])
    for _, t_ns, _, row in heapq.merge(*turns, key=lambda one: (one[0], one[2])):
        yield t_ns, row


def pc_time_ns(row: Row, run: RunInfo) -> int:
    """A row's time on the PC's clock [ns], never below 0; 0 for rows without a time."""
    clocks = {"t_pc_s": 0.0, "t_camera_s": run.camera_to_pc_offset_s or 0.0, "t_plc_s": run.plc_to_pc_offset_s or 0.0}
    own = [getattr(row, name) + offset_s for name, offset_s in clocks.items() if hasattr(row, name)]
    t_s = own[0] if own else 0.0
    return round(max(t_s, 0.0) * 1e9) if math.isfinite(t_s) else 0
