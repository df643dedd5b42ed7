"""Several recordings of one machine as one: the second recorded to separate what the first could not distinguish.

They are laid end to end on the first one's clocks. What stands still between them (the object of interest, the tracker)
is taken to stand still over all of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from diagnosis.errors import DiagnosisError
from diagnosis.log.findings import by_channel
from diagnosis.log.tables import JOINT_SIGNAL_COLUMNS
from diagnosis.reading.read import Read, column_findings, examine_recording, in_recording, is_folder, read_for_diagnosis
from recording.content import Recording
from recording.errors import RecordingError
from recording.opening import read_run
from recording.rows import MISSING_COUNT, MarkerCorners, OdometryRow, PlcState, Row, Sent, StaticPoint, TrackerPoint
from recording.run import RunInfo, Segment

DATAGRAM_NUMBER_MAX = 2**53  # of a datagram: beyond it are numbers that say "none"
RECORDING_GAP_S = 10.0  # between the end of one and the start of the next


@dataclass(frozen=True, slots=True)
class _RecordingShift:
    """What is added to a recording's times on each clock, its sequence numbers and its pose numbers; its label."""

    plc_s: float
    pc_s: float
    camera_s: float
    sequence_offset: int
    pose_index_offset: int
    label_suffix: str


def read_together(paths: Sequence[Path], machine_file: Path | None = None) -> Read:
    """Read one recording, or several of one machine as one.

    Raises: DiagnosisError: one of several cannot be read, or they cannot belong together; says why.
    """
    if len(paths) == 1:
        return read_for_diagnosis(paths[0], machine_file)
    twice = [path for k, path in enumerate(paths) if path.resolve() in {earlier.resolve() for earlier in paths[:k]}]
    if twice:
        raise DiagnosisError(f"{twice[0].name} is given twice, which says no more than once; name it once")
    try:
        recordings = [read_run(path) for path in paths]
    except RecordingError as error:
        raise DiagnosisError(str(error)) from error
    before = [finding for path in paths for finding in in_recording(column_findings(path), path)]
    whole = examine_recording(
        join_recordings(recordings, machine_file is not None), paths[0], machine_file, before, paths[1:]
    )
    if any(is_folder(path) for path in paths):
        return whole
    return replace(whole, findings=tuple(by_channel(finding) for finding in whole.findings))


def join_recordings(recordings: Sequence[Recording], machine_given: bool = False) -> Recording:
    """Recordings of one machine, the first one's clocks carried on.

    Raises: DiagnosisError: other machine files, other numbers of joints, or an offset of clocks known in one only.
    """
    _require_as_many_joints(recordings)
    first = recordings[0]
    rows: list[Row] = list(first.rows)
    segments = list(first.run_info.segments or _whole_segment(first, ""))
    for number, recording in enumerate(recordings[1:], start=2):
        if not machine_given and recording.machine_toml.strip() != first.machine_toml.strip():
            raise DiagnosisError(f"recording {number} has another machine.toml than the first; give one by --machine")
        shift = _recording_shift(first, recording, rows, number)
        rows += [_shift_row(row, shift) for row in recording.rows]
        segments += [
            _shift_segment(segment, shift) for segment in recording.run_info.segments or _whole_segment(recording, "")
        ]
    whole = all(recording.complete for recording in recordings)
    return replace(first, run_info=replace(first.run_info, segments=tuple(segments)), rows=tuple(rows), complete=whole)


def _require_as_many_joints(recordings: Sequence[Recording]) -> None:
    counts = {number: _joint_count(recording) for number, recording in enumerate(recordings, start=1)}
    counted = {number: count for number, count in counts.items() if count}
    for number, count in counted.items():
        first, others = next(iter(counted.items()))
        if count != others:
            text = f"recording {number} has {count} joints, recording {first} has {others}"
            raise DiagnosisError(f"{text}; give recordings of one machine with the same columns")


def _joint_count(recording: Recording) -> int:
    """How many joints its rows describe; 0 where they describe none."""
    fields = {PlcState: [field for _, field, _ in JOINT_SIGNAL_COLUMNS], Sent: ["q_sent_rad"], StaticPoint: ["q_rad"]}
    return max((len(getattr(row, name)) for row in recording.rows for name in fields.get(type(row), ())), default=0)


def _recording_shift(first: Recording, recording: Recording, rows: list[Row], number: int) -> _RecordingShift:
    """So that a recording begins after all rows so far, with the first one's offsets between the clocks.

    Model: t_plc' = t_plc + s; t_pc' = t_plc' + offset of the first, so t_pc' = t_pc + s + offset_first - offset_own.
    """
    end = max(_plc_times(first.run_info, rows), default=0.0)
    start = min(_plc_times(recording.run_info, recording.rows), default=0.0)
    s = end + RECORDING_GAP_S - start
    pc = s + _clock_offset_difference(first, recording, number, "plc_to_pc_offset_s")
    camera = pc - _clock_offset_difference(first, recording, number, "camera_to_pc_offset_s")
    seq = 1 + max((number for row in rows if 0 <= (number := _number_of(row)) <= DATAGRAM_NUMBER_MAX), default=0)
    pose = 1 + max((row.pose_index for row in rows if isinstance(row, StaticPoint)), default=0)
    return _RecordingShift(s, pc, camera, seq, pose, f" ({number})")


def _number_of(row: Row) -> int:
    """The number of the datagram that a row belongs to."""
    match row:
        case Sent():
            return row.seq
        case PlcState():
            return row.seq_received
        case _:
            return MISSING_COUNT


def _later_number(number: int, by: int) -> int:
    """A row without a number stays without one."""
    return number + by if 0 <= number <= DATAGRAM_NUMBER_MAX else number


def _clock_offset_difference(first: Recording, recording: Recording, number: int, name: str) -> float:
    a, b = getattr(first.run_info, name), getattr(recording.run_info, name)
    if a is None and b is None:
        return 0.0
    if a is None or b is None:
        which = number if b is None else 1
        raise DiagnosisError(f"clocks.{name} is missing in recording {which} and given in another; give it in both")
    return float(a - b)


def _plc_times(run: RunInfo, rows: Sequence[Row]) -> list[float]:
    """Times of all rows on the PLC's clock [s]."""
    to_plc = -(run.plc_to_pc_offset_s or 0.0)
    camera = (run.camera_to_pc_offset_s or 0.0) + to_plc
    read_time: dict[type[Row], Callable[[Row], float]] = {
        PlcState: lambda row: row.t_plc_s,  # pyright: ignore[reportAttributeAccessIssue]
        Sent: lambda row: row.t_pc_s + to_plc,  # pyright: ignore[reportAttributeAccessIssue]
        TrackerPoint: lambda row: row.t_plc_s,  # pyright: ignore[reportAttributeAccessIssue]
        MarkerCorners: lambda row: row.t_camera_s + camera,  # pyright: ignore[reportAttributeAccessIssue]
        OdometryRow: lambda row: row.t_camera_s + camera,  # pyright: ignore[reportAttributeAccessIssue]
    }
    times = [read_time[type(row)](row) for row in rows if type(row) in read_time]
    return [t for t in times if abs(t) < 1e12]  # neither NaN nor a broken number


def _shift_row(row: Row, by: _RecordingShift) -> Row:
    match row:
        case PlcState():
            seq = _later_number(row.seq_received, by.sequence_offset)
            return replace(row, t_plc_s=row.t_plc_s + by.plc_s, seq_received=seq)
        case Sent():
            return replace(row, t_pc_s=row.t_pc_s + by.pc_s, seq=_later_number(row.seq, by.sequence_offset))
        case TrackerPoint():
            return replace(row, t_plc_s=row.t_plc_s + by.plc_s)
        case StaticPoint():
            return replace(row, pose_index=_later_number(row.pose_index, by.pose_index_offset))
        case MarkerCorners() | OdometryRow():
            return replace(row, t_camera_s=row.t_camera_s + by.camera_s)
        case _:
            return row


def _whole_segment(recording: Recording, name: str) -> tuple[Segment, ...]:
    times = [row.t_plc_s for row in recording.of(PlcState)]
    return (Segment(name or "whole", "workcycle", min(times), max(times)),) if times else ()


def _shift_segment(segment: Segment, by: _RecordingShift) -> Segment:
    """A segment of a later recording: its repeats repeat nothing of another one."""
    return replace(
        segment,
        name=f"{segment.name}{by.label_suffix}",
        t_start_plc_s=segment.t_start_plc_s + by.plc_s,
        t_end_plc_s=segment.t_end_plc_s + by.plc_s,
        repeat_of=f"{segment.repeat_of}{by.label_suffix}" if segment.repeat_of else "",
    )
