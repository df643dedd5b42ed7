"""Check a recording: signals present, signals missing, and what each missing one costs the diagnosis."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machine.description import parse_machine_toml
from machine.errors import MachineError
from recording.content import Recording, column
from recording.opening import read_run
from recording.recover import RECOVERED_METADATA_NAME
from recording.rows import MarkerCorners, OdometryRow, PlcState, Row, Sent, StaticPoint, TrackerPoint

GAP_FACTOR = 3.0  # a step in time beyond this many median steps is a gap


@dataclass(frozen=True, slots=True)
class SignalCheck:
    """One kind of rows: how many, how fast, how long, with how many gaps."""

    name: str
    n_rows: int
    rate_hz: float
    duration_s: float
    n_gaps: int


@dataclass(frozen=True, slots=True)
class MissingSignalFinding:
    """A missing signal. `cost` says what can no longer be distinguished, and `remedy` how to get it."""

    signal: str
    cost: str
    remedy: str


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Result of a check. `usable`: at least one stage of the gap can be examined."""

    path: Path
    complete: bool
    signals: tuple[SignalCheck, ...]
    missing_signals: tuple[MissingSignalFinding, ...]
    problems: tuple[str, ...]
    usable: bool
    n_images: int


def _is_plc_field_recorded(recording: Recording, name: str) -> bool:
    """Whether a field of the PLC's rows has any number in it."""
    return any(value == value and value != () for value in (getattr(row, name) for row in recording.of(PlcState)))


def _link_side(recording: Recording) -> bool:
    return bool(recording.of(MarkerCorners) or recording.of(TrackerPoint) or recording.of(StaticPoint))


# fmt: off
_NEEDS: tuple[tuple[str, Callable[[Recording], bool], str, str], ...] = (
    (
        "sent.csv", lambda recording: bool(recording.of(Sent)),
        "the link stage cannot be examined: delay and loss between PC and PLC stay unknown",
        "log the reference as the PC sends it",
    ),
    (
        "plc.csv q_ref", lambda recording: _is_plc_field_recorded(recording, "q_ref_rad"),
        "stages link and controller merge, and the actuator with them where no valve command is logged",
        "log the reference that the PLC works with",
    ),
    (
        "plc.csv q", lambda recording: _is_plc_field_recorded(recording, "q_rad"),
        "controller and actuator cannot be examined, nor points and object markers in motion; poses at rest can",
        "log the encoders",
    ),
    (
        "plc.csv u", lambda recording: _is_plc_field_recorded(recording, "u_frac"),
        "stages controller and actuator merge: dead band and controller gain cannot be distinguished",
        "log the valve commands",
    ),
    (
        "markers.csv, tracker.csv or static.csv", _link_side,
        "stages joint, structure and camera cannot be examined: nothing was measured behind the encoders",
        "record the camera or an external tracker",
    ),
    (
        "tracker.csv or static.csv", lambda recording: bool(recording.of(TrackerPoint) or recording.of(StaticPoint)),
        "stages structure and camera merge: the camera alone cannot separate its own errors from those of the boom",
        "measure a few poses at rest by an external tracker",
    ),
    (
        "odometry.csv", lambda recording: bool(recording.of(OdometryRow)),
        "the camera motion is known only while markers are visible", "switch odometry on, or keep the wall in view",
    ),
    (
        "segments with repeat_of", lambda recording: any(segment.repeat_of for segment in recording.run_info.segments),
        "the noise floor must be assumed: no command was repeated",
        "drive at least one command four times and name its runs in run.toml",
    ),
    (
        "machine.toml", lambda recording: bool(recording.machine_toml), "there is no nominal machine to compare with",
        "add the nominal machine file to the recording",
    ),
)
# fmt: on

_TIMES: tuple[tuple[type[Row], str], ...] = (
    (Sent, "t_pc_s"),
    (PlcState, "t_plc_s"),
    (MarkerCorners, "t_camera_s"),
    (OdometryRow, "t_camera_s"),
    (TrackerPoint, "t_plc_s"),
)


def check_recording(path: Path) -> CheckReport:
    """Check the recording at this path. Raises: RecordingError when it cannot be read at all."""
    recording = read_run(path)
    signals = [_signal_timing_check(row_type, name, recording) for row_type, name in _TIMES if recording.of(row_type)]
    static = recording.of(StaticPoint)
    if static:
        signals.append(SignalCheck("static", len(static), 0.0, 0.0, 0))
    missing = tuple(
        MissingSignalFinding(name, cost, remedy) for name, is_there, cost, remedy in _NEEDS if not is_there(recording)
    )
    names = {signal.signal for signal in missing}
    return CheckReport(
        path=path,
        complete=recording.complete,
        signals=tuple(signals),
        missing_signals=missing,
        problems=tuple(_recording_problems(recording)),
        usable="machine.toml" not in names and ("plc.csv q" not in names or bool(static)),
        n_images=recording.n_images,
    )


def _signal_timing_check(row_type: type[Row], time_name: str, recording: Recording) -> SignalCheck:
    rows = recording.of(row_type)
    times_s = np.unique(column(rows, time_name))  # markers share their pair's time
    steps_s = np.diff(times_s[np.isfinite(times_s)])
    median_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    gaps = int(np.sum(steps_s > GAP_FACTOR * median_s)) if median_s > 0.0 else 0
    duration_s = float(steps_s.sum())
    rate_hz = len(steps_s) / duration_s if duration_s > 0.0 else 0.0
    return SignalCheck(row_type.topic.strip("/"), len(rows), rate_hz, duration_s, gaps)


def _recording_problems(recording: Recording) -> list[str]:
    problems: list[str] = []
    if not recording.complete:
        remedy = "`longreach recording recover` writes a complete file from the readable part"
        problems.append(
            "it was made of a cut or damaged file" if recording.run_info.cut else f"the file was cut; {remedy}"
        )
    left = dict(recording.metadata)
    if (lost := left.get(f"{RECOVERED_METADATA_NAME}.lost_chunks")) is not None:
        problems.append(
            f"it holds the readable part of a damaged file: {lost} chunks lost, "
            f"{left[f'{RECOVERED_METADATA_NAME}.reason']}"
        )
    problems += [f"channel {channel}: it is not of this format" for channel in recording.foreign_channels]
    for row_type, name in _TIMES:
        times_s = column(recording.of(row_type), name)
        back = int(np.sum(np.diff(times_s) < 0.0))
        if back:
            problems.append(f"{row_type.topic.strip('/')}: {name} runs backwards {back} times; sort the rows by time")
    problems += _machine_problems(recording)
    if recording.run_info.plc_to_pc_offset_s is None and recording.of(Sent):
        problems.append("run.toml has no clocks.plc_to_pc_offset_s: the link delay is known only up to a constant")
    return problems


def _machine_problems(recording: Recording) -> list[str]:
    if not recording.machine_toml:
        return []
    try:
        machine = parse_machine_toml(recording.machine_toml)
    except MachineError as error:
        return [f"machine.toml cannot be used as a full machine: {error}"]
    plc = recording.of(PlcState)
    joints = max((len(row.q_rad) for row in plc), default=0)
    if joints and joints != len(machine.joints):
        return [f"plc.csv has {joints} joints, machine.toml {len(machine.joints)}; both must agree"]
    return []
