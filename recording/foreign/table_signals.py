"""Assign table columns to signals: by the mapping file, else by guesses to confirm."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from machine.rotations import Array
from recording.errors import RecordingError
from recording.foreign.found import JointSignal, Kind, SourceContents, SourceEntry, TrackedPointSeries, in_time_order
from recording.foreign.mapping import ColumnMapping, Mapping
from recording.foreign.table_files import TableColumn, read_table
from recording.foreign.table_names import guess_column, joint_numbers, unit_factor

# Median steps that a time falls back by where an episode begins; a late row falls back by a few
EPISODE_RESTART_STEPS = 10.0
EPISODE_RESTARTS_MAX_FRAC = 0.05  # an episode has 20 rows at least
EPISODE_GAP_S = 10.0  # longer than any step: nothing is read across it
KINDS: dict[str, Kind] = {"q": "position", "q_ref": "reference", "qd_ref": "velocity_reference", "u": "command"}


def table_found(path: Path, mapping: Mapping) -> SourceContents:
    """What a table holds, and what each column is taken for.

    Raises: RecordingError: unreadable, a column of the mapping that is not there, no time, or no joint.
    """
    columns = read_table(path)
    wanted = _checked_column_mapping(columns, mapping, path) if mapping.column else _guessed_column_mapping(columns)
    found = SourceContents(joints_numbered=True)
    clock = _table_time_axis(columns, wanted, mapping, path)
    found.started_s = clock[1]
    episodes = 0 if clock[0] is None else int(np.sum(np.diff(clock[0]) >= EPISODE_GAP_S))
    if episodes:
        found.notes.append(f"gaps of {EPISODE_GAP_S:g} s or more: {episodes}; times that start again count as episodes")
    kinds: dict[Kind, list[tuple[int, JointSignal]]] = {}
    for column in columns:
        one, guess = wanted.get(column.name), not mapping.column
        if one is None or one.signal == "ignored":
            why = "not in the mapping file" if mapping.column else _why_ignored(column)
            found.entries.append(SourceEntry(column.name, "", len(column.values), "ignored", why))
            continue
        joint = f" of joint {one.joint}" if one.joint else f" of point {one.point}" if one.point else ""
        how = "guessed" if guess else "as the mapping says"
        found.entries.append(
            SourceEntry(
                column.name, one.signal, len(column.values), "used", f"{one.signal}{joint} in {one.unit}, {how}", guess
            )
        )
        if one.signal in KINDS:
            kinds.setdefault(KINDS[one.signal], []).append(
                (one.joint or 1, _joint_signal_from_column(column, one, clock[0]))
            )
    for kind, several in kinds.items():
        found.signals += _merge_joint_signals(kind, several)
    _require_centred_commands(kinds.get("command", ()), kinds.get("position", ()))
    found.tracked_points += _tracked_point_series(columns, wanted, clock[0])
    found.command_kind = _command_kind(wanted.values())
    if not found.signals_of("position") and not found.tracked_points:
        raise RecordingError(
            f"{path}: no column is a joint's position, of {_column_names_text(columns)}: give a mapping file"
        )
    return found


def _require_centred_commands(
    commands: Sequence[tuple[int, JointSignal]], positions: Sequence[tuple[int, JointSignal]]
) -> None:
    """Raises: RecordingError: a command is never 0, and its joint moves both ways: it does not rest at 0."""
    moved = {number: signal.values[:, 0] for number, signal in positions}
    for number, command in commands:
        u, q = command.values[:, 0], moved.get(number)
        if q is None or np.nanmin(u) <= 0.0 <= np.nanmax(u) or not _moves_both_ways(q[np.isfinite(q)]):
            continue
        raise RecordingError(
            f"column {command.source!r} (u of joint {number}) is never 0 ({np.nanmin(u):.3g} to {np.nanmax(u):.3g}), "
            "and the joint moves both ways: subtract what the command is at rest"
        )


def _moves_both_ways(q: Array) -> bool:
    """Whether it rises and falls by more than a fifth of its range."""
    if len(q) == 0:
        return False
    fallen, risen = np.max(np.maximum.accumulate(q) - q), np.max(q - np.minimum.accumulate(q))
    return bool(min(fallen, risen) > 0.2 * np.ptp(q))


def _why_ignored(column: TableColumn) -> str:
    guess = guess_column(column.name, column.unit, column.values)
    return guess.reason if guess.signal == "ignored" else f"{guess.reason}; another column is taken for it"


def _column_names_text(columns: Sequence[TableColumn]) -> str:
    return ", ".join(column.name for column in columns[:30])


def _checked_column_mapping(columns: Sequence[TableColumn], mapping: Mapping, path: Path) -> dict[str, ColumnMapping]:
    known = {column.name for column in columns}
    for column in mapping.column:
        if column.name not in known:
            raise RecordingError(
                f"{path} has no column {column.name!r} of the mapping; it has {_column_names_text(columns)}"
            )
        if column.signal in ("q", "q_ref", "qd_ref", "u") and column.joint is None:
            raise RecordingError(f"mapping: column {column.name!r} is {column.signal}: give its joint, from 1")
        if column.signal != "ignored":
            unit_factor(column.unit, column.signal)
    return {column.name: column for column in mapping.column}


def _guessed_column_mapping(columns: Sequence[TableColumn]) -> dict[str, ColumnMapping]:
    guesses = {column.name: guess_column(column.name, column.unit, column.values) for column in columns}
    places = joint_numbers([guess.joint for guess in guesses.values() if guess.signal in KINDS])
    out: dict[str, ColumnMapping] = {}
    taken: set[tuple[str, int | str]] = set()
    for name, guess in guesses.items():
        joint = places[guess.joint] if guess.signal in KINDS else None
        key = (guess.signal, joint if joint is not None else guess.point)
        if guess.signal == "ignored" or key in taken:
            continue
        taken.add(key)
        unit = _common_angle_unit(
            guess.signal, guess.unit, [other.unit for other in guesses.values() if other.signal == guess.signal]
        )
        out[name] = ColumnMapping(name=name, signal=guess.signal, joint=joint, point=guess.point, unit=unit)
    return out


def _common_angle_unit(signal: str, unit: str, units: Sequence[str]) -> str:
    """One joint beyond a whole turn in rad makes all of its kind degrees: a table has one unit per signal."""
    return "deg" if signal in ("q", "q_ref", "qd_ref") and unit == "rad" and "deg" in units else unit


def _table_time_axis(
    columns: Sequence[TableColumn], wanted: dict[str, ColumnMapping], mapping: Mapping, path: Path
) -> tuple[Array | None, float]:
    """The table's times (m,) [s] since the first, and the first [s since 1970] if it is; None: columns have theirs."""
    named = [column for column in columns if column.name in wanted and wanted[column.name].signal == "time"]
    if named:
        times = named[0].values * unit_factor(wanted[named[0].name].unit, "time")
        first = float(times[np.isfinite(times)][0])
        return _continued(times - first), first if first > 1e8 else 0.0
    if all(column.t_s is not None for column in columns):
        return None, 0.0
    if mapping.rate_hz is not None:
        return np.arange(len(columns[0].values)) / mapping.rate_hz, 0.0
    raise RecordingError(
        f"{path} has no column of times ({_column_names_text(columns)}); "
        "name one in a mapping file, or give its rate_hz there"
    )


def _continued(t_s: Array) -> Array:
    """Times that start again at each episode (m,) [s] as one course, EPISODE_GAP_S between two episodes.

    A few late rows, or rows in no order at all, are no episodes: those are sorted.
    """
    steps = np.diff(t_s)
    back = np.flatnonzero(steps < -EPISODE_RESTART_STEPS * np.median(np.abs(steps)))
    if len(back) == 0 or len(back) > EPISODE_RESTARTS_MAX_FRAC * len(steps):
        return t_s
    shifts = np.zeros(len(t_s))
    shifts[back + 1] = EPISODE_GAP_S - steps[back]
    return t_s + np.cumsum(shifts)


def _joint_signal_from_column(column: TableColumn, one: ColumnMapping, clock: Array | None) -> JointSignal:
    t = column.t_s if clock is None else clock
    assert t is not None  # _clock: every column has times of its own where the table has none
    good = np.isfinite(t)
    t, values = in_time_order(t[good], column.values[good] * unit_factor(one.unit, one.signal))
    return JointSignal(KINDS[one.signal], column.name, (f"joint{one.joint}",), t, values[:, None], one.signal == "u")


def _merge_joint_signals(kind: Kind, several: Sequence[tuple[int, JointSignal]]) -> list[JointSignal]:
    """Joints on one time axis as one signal; others stay apart."""
    groups: list[list[tuple[int, JointSignal]]] = []
    for number, signal in sorted(several, key=lambda pair: pair[0]):
        group = next((g for g in groups if np.array_equal(g[0][1].t_s, signal.t_s)), None)
        if group is None:
            groups.append([(number, signal)])
        else:
            group.append((number, signal))
    out = []
    for group in groups:
        signals = [signal for _, signal in group]
        values = np.hstack([signal.values for signal in signals])
        names = tuple(signal.joint_names[0] for signal in signals)
        out.append(JointSignal(kind, signals[0].source, names, signals[0].t_s, values, signals[0].hold_last_value))
    return out


def _tracked_point_series(
    columns: Sequence[TableColumn], wanted: dict[str, ColumnMapping], clock: Array | None
) -> list[TrackedPointSeries]:
    axes: dict[str, dict[str, TableColumn]] = {}
    for column in columns:
        one = wanted.get(column.name)
        if one is not None and one.signal in ("x", "y", "z"):
            axes.setdefault(one.point or "point", {})[one.signal] = column
    out = []
    for point, three in axes.items():
        t = clock if clock is not None else three[min(three)].t_s
        if len(three) < 3 or t is None:
            continue
        xyz = np.stack(
            [three[a].values * unit_factor(wanted[three[a].name].unit, "x") for a in ("x", "y", "z")], axis=1
        )
        good = np.isfinite(t)
        out.append(TrackedPointSeries(point, three["x"].name, *in_time_order(t[good], xyz[good])))
    return out


def _command_kind(columns: Iterable[ColumnMapping]) -> str:
    units = [column.unit for column in columns if column.signal == "u"]
    if not units:
        return ""
    return "valve" if units[0].lower() in ("frac", "%", "percent", "pct") else "velocity"


def proposed_table_mapping(path: Path) -> str:
    """Every column of a table as a mapping file, to be corrected: its guess, or ignored.

    Raises: RecordingError: unreadable.
    """
    columns = read_table(path)
    guesses, lines = _guessed_column_mapping(columns), []
    for name in (column.name for column in columns):
        column = guesses.get(name, ColumnMapping(name=name, signal="ignored"))
        lines += ["[[column]]", f"name = {json.dumps(column.name)}", f'signal = "{column.signal}"']
        lines += [f"joint = {column.joint}"] if column.joint is not None else []
        lines += [f"point = {json.dumps(column.point)}"] if column.point else []
        lines += [f"unit = {json.dumps(column.unit)}"] if column.unit else []
        lines.append("")
    return "\n".join(lines)
