"""Assemble the signals found in a log on one time axis, as the folder form of a recording."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from machine.rotations import Array
from recording.errors import RecordingError
from recording.files import read_text
from recording.foreign.found import JointSignal, SourceContents, TrackedPointSeries
from recording.foreign.machine_file import drive_model, machine_toml, with_fitted_gains, with_fitted_position_loops
from recording.foreign.mapping import Mapping
from recording.foreign.urdf_ends import ChosenChain, chain_for
from recording.rows import TrackerPoint, csv_fields
from recording.run import RunInfo, run_to_toml

ENCODER_ROWS_MAX = 2_000_000  # of plc.csv: what the diagnosis reads takes about a kilobyte a row
CARRY_GAP_MAX_STEPS = 5.0  # a value is not carried over a longer gap of its source


@dataclass(frozen=True, slots=True)
class AssembledRecording:
    """A recording to be written: joint signals (m, n) on t_s (m,), None where not recorded; points; text files."""

    t_s: Array
    q_encoder: Array | None
    q_ref: Array | None
    qd_ref: Array | None
    valve_command: Array | None
    prismatic: tuple[bool, ...]
    tracked_points: tuple[TrackedPointSeries, ...]
    run_info: RunInfo
    machine_toml: str
    urdf_name_and_text: tuple[str, str]
    notes: tuple[str, ...]


def assemble(found: SourceContents, mapping: Mapping, name: str, urdf: Path | None) -> AssembledRecording:
    """All joints on the encoders' time axis.

    Raises: RecordingError: no joint was recorded, too many rows, or a URDF that cannot be read or is of another robot.
    """
    if mapping.joint_names:
        found = _with_joint_names(found, mapping.joint_names)
    recorded = [joint for signal in found.signals_of("position") for joint in signal.joint_names]
    text = _urdf_text(urdf)
    chain = None
    if text:
        chain = chain_for(text, () if found.joints_numbered else recorded, mapping.urdf, len(set(recorded)))
    if chain is not None and found.joints_numbered:
        found = _named_by_chain(found, chain)
        recorded = [joint for signal in found.signals_of("position") for joint in signal.joint_names]
    joints, notes = _select_joint_order(found, mapping, chain, recorded)
    base = max(
        found.signals_of("position"),
        key=lambda one: (len(set(one.joint_names) & set(joints)), len(one.t_s)),
        default=None,
    )
    t = base.t_s if base is not None else found.signals_of("reference")[0].t_s
    if len(t) > ENCODER_ROWS_MAX:
        raise RecordingError(
            f"{len(t)} rows of encoders, limit {ENCODER_ROWS_MAX}; read a part by [window] from_s and to_s of the "
            "mapping file"
        )
    signals = {
        kind: _on_axis(found.signals_of(kind), joints, t) for kind in ("position", "reference", "velocity_reference")
    }
    command, sliding = _on_axis(found.signals_of("command"), joints, t), _prismatic_joint_flags(joints, chain)
    limits = _velocity_limits(joints, chain)
    largest = (
        np.zeros(len(joints)) if command is None else np.nan_to_num(np.nanmax(np.abs(command), axis=0, initial=0.0))
    )
    drive = drive_model(mapping.actuator, found.command_kind, limits, [float(value) for value in largest])
    if found.command_kind == "valve" and command is not None and mapping.actuator.velocity_max is None:
        drive = with_fitted_gains(drive, t, signals["position"], command)
    bandwidths = (mapping.actuator.bandwidth_hz, mapping.actuator.velocity_bandwidth_hz)
    if drive.command_kind == "position" and bandwidths == (None, None):
        drive = with_fitted_position_loops(drive, t, signals["position"], signals["reference"])
    step_s = float(f"{np.median(np.diff(t)):.6g}") if len(t) > 1 else 0.01
    on_joint = {tracker.point: tracker.joint for tracker in mapping.ros.tracker if tracker.joint is not None}
    points = {track.name: on_joint.get(track.name, len(joints)) for track in found.tracked_points}
    machine = machine_toml(name, joints, sliding, drive, step_s, chain, urdf.name if urdf else "", points)
    if command is not None and found.command_kind != "valve":
        command = command / np.array(drive.velocity_max)
    started = datetime.fromtimestamp(found.started_s, UTC).isoformat() if found.started_s > 1e6 else ""
    return AssembledRecording(
        t_s=t,
        q_encoder=signals["position"],
        q_ref=signals["reference"],
        qd_ref=signals["velocity_reference"],
        valve_command=command,
        prismatic=sliding,
        tracked_points=tuple(found.tracked_points),
        run_info=RunInfo(name, started_utc=started, cut=found.truncated),
        machine_toml=machine,
        urdf_name_and_text=(urdf.name if urdf else "", text),
        notes=(*notes, *drive.notes),
    )


def _with_joint_names(found: SourceContents, names: dict[str, str]) -> SourceContents:
    """The joints by the mapping's names. Raises: RecordingError: a joint of the mapping was not recorded."""
    recorded = {joint for signal in found.signals for joint in signal.joint_names}
    unknown = sorted(set(names) - recorded)
    if unknown:
        raise RecordingError(
            f"joints {unknown} of joint_names were not recorded; recorded are {', '.join(sorted(recorded))}"
        )
    return _renamed_joints(found, names)


def _renamed_joints(found: SourceContents, names: dict[str, str]) -> SourceContents:
    signals = [
        replace(signal, joint_names=tuple(names.get(joint, joint) for joint in signal.joint_names))
        for signal in found.signals
    ]
    return replace(found, signals=signals, joints_numbered=False)


def _named_by_chain(found: SourceContents, chain: ChosenChain) -> SourceContents:
    """Numbered joints get the names of the chain's moving joints, in their order. Raises: RecordingError: too many."""
    names = [joint.name for joint in chain.joints]
    most = max(int(joint.removeprefix("joint")) for signal in found.signals for joint in signal.joint_names)
    if most > len(names):
        raise RecordingError(
            f"joint {most} was recorded, and {len(names)} joints move between {chain.base_link} and {chain.tip_link} "
            "of the URDF; give base_link and tip_link under [urdf] of the mapping file, or correct the joints' numbers"
        )
    return _renamed_joints(found, {f"joint{number}": name for number, name in enumerate(names, start=1)})


def _urdf_text(urdf: Path | None) -> str:
    if urdf is None:
        return ""
    try:
        return read_text(urdf)
    except OSError as error:
        raise RecordingError(f"URDF {urdf} cannot be read: {error.strerror}") from error


def _select_joint_order(
    found: SourceContents, mapping: Mapping, chain: ChosenChain | None, recorded: Sequence[str]
) -> tuple[tuple[str, ...], list[str]]:
    """The joint vector: the mapping's, else the chain's, else as recorded; and what is said of the others."""
    notes = []
    if mapping.joints:
        missing = [joint for joint in mapping.joints if joint not in recorded]
        if missing:
            raise RecordingError(
                f"joints {missing} of the mapping were not recorded; recorded are {sorted(set(recorded))}"
            )
        joints = tuple(mapping.joints)
    elif chain is not None:
        joints = tuple(joint.name for joint in chain.joints if joint.name in recorded)
    else:
        signals = found.signals_of("position") or found.signals_of("reference")
        if not signals:
            raise RecordingError("no joint positions were found; name them in a mapping file")
        joints = max(signals, key=lambda signal: len(signal.t_s)).joint_names
        if found.joints_numbered:
            numbers = {int(joint.removeprefix("joint")) for signal in signals for joint in signal.joint_names}
            joints = tuple(f"joint{number}" for number in range(1, max(numbers) + 1))
    if chain is not None:
        chosen = "chosen by the recorded joints" if chain.is_guess else "as the mapping says"
        notes.append(f"URDF chain {chain.base_link} -> {chain.tip_link}, {chosen}: {', '.join(joints)}")
        held = [joint.name for joint in chain.joints if joint.name not in joints]
        notes += [f"joints {', '.join(held)} of the chain were not recorded and are held at 0"] if held else []
    others = sorted(set(recorded) - set(joints))
    notes += [f"recorded joints that are not used: {', '.join(others)}"] if others else []
    return joints, notes


def _prismatic_joint_flags(joints: Sequence[str], chain: ChosenChain | None) -> tuple[bool, ...]:
    kinds = {joint.name: joint.joint_type for joint in chain.joints} if chain is not None else {}
    return tuple(kinds.get(joint) == "prismatic" for joint in joints)


def _velocity_limits(joints: Sequence[str], chain: ChosenChain | None) -> list[float]:
    known = {joint.name: joint.velocity_max for joint in chain.joints} if chain is not None else {}
    return [known.get(joint, float("inf")) for joint in joints]


def _on_axis(signals: Sequence[JointSignal], joints: Sequence[str], t: Array) -> Array | None:
    """The numbers of each joint at t (m, n), from the signal that has most of it; None where no joint was recorded."""
    out = np.full((len(t), len(joints)), np.nan)
    for k, joint in enumerate(joints):
        having = [signal for signal in signals if joint in signal.joint_names]
        if having:
            signal = max(having, key=lambda one: len(one.t_s))
            out[:, k] = _values_at_times(
                signal.t_s, signal.values[:, signal.joint_names.index(joint)], t, signal.hold_last_value
            )
    return out if np.isfinite(out).any() else None


def _values_at_times(t_of: Array, values: Array, t: Array, held: bool) -> Array:
    """Values at other times: the last one before, or a line between two that are not further apart than a gap."""
    good = np.isfinite(values)
    t_of, values = t_of[good], values[good]
    if len(t_of) == len(t) and np.array_equal(t_of, t):
        return values
    if not len(t_of):
        return np.full(len(t), np.nan)
    last = np.searchsorted(t_of, t, side="right") - 1
    if held:
        return np.where(last >= 0, values[np.maximum(last, 0)], np.nan)
    out = np.interp(t, t_of, values, left=np.nan, right=np.nan)
    steps = np.diff(t_of)
    if len(steps):
        in_gap = steps[np.clip(last, 0, len(steps) - 1)] > CARRY_GAP_MAX_STEPS * np.median(steps)
        exact = np.isin(t, t_of)
        moves = np.abs(np.diff(values))[np.clip(last, 0, len(steps) - 1)] > 0.0
        out[in_gap & ~exact & moves] = np.nan
    return out


def write_assembled(recording: AssembledRecording, folder: Path) -> None:
    """Write the folder form. Raises: RecordingError: it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "run.toml").write_text(run_to_toml(recording.run_info), encoding="utf-8")
        (folder / "machine.toml").write_text(recording.machine_toml, encoding="utf-8")
        if recording.urdf_name_and_text[1]:
            (folder / recording.urdf_name_and_text[0]).write_text(recording.urdf_name_and_text[1], encoding="utf-8")
        if recording.q_encoder is not None or recording.q_ref is not None:
            _write_plc(recording, folder / "plc.csv")
        if recording.tracked_points:
            _write_points(recording.tracked_points, folder / TrackerPoint.file)
    except OSError as error:
        raise RecordingError(f"folder {folder}: {error.strerror}; choose a folder that can be written") from error


def _write_plc(recording: AssembledRecording, path: Path) -> None:
    header, parts = ["t_plc_s"], [recording.t_s[:, None]]
    for pattern, values in (
        ("q_ref_{j}_rad", recording.q_ref),
        ("qd_ref_{j}_rad_s", recording.qd_ref),
        ("q_{j}_rad", recording.q_encoder),
        ("u_{j}_frac", recording.valve_command),
    ):
        if values is not None:
            header += [_joint_column_name(pattern, k, slides) for k, slides in enumerate(recording.prismatic, start=1)]
            parts.append(values)
    _write_rows(path, header, np.hstack(parts))


def _joint_column_name(pattern: str, joint: int, slides: bool) -> str:
    name = pattern.replace("{j}", str(joint))
    return re.sub("_rad", "_m", name) if slides else name


def _write_rows(path: Path, header: Sequence[str], table: Array) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for start in range(
            0, len(table), 10_000
        ):  # a block at a time: text of all rows takes far more than the numbers
            block = table[start : start + 10_000].tolist()
            writer.writerows(["" if value != value else repr(value) for value in row] for row in block)


def _write_points(points: Sequence[TrackedPointSeries], path: Path) -> None:
    rows = [
        (t, track.name, x, y, z)
        for track in points
        for t, (x, y, z) in zip(track.t_s.tolist(), track.xyz_m.tolist(), strict=True)
        if np.isfinite(x + y + z)
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([pattern for _, pattern in csv_fields(TrackerPoint)])
        writer.writerows(sorted(rows))
