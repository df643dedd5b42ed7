"""Guess the signal of a table column from the words of its name, its unit, and the size of its numbers."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine.rotations import Array
from recording.errors import RecordingError
from recording.foreign.mapping import ColumnSignal

#: Factor to s, rad, m, rad/s, m/s or a share; by how a unit is written.
# fmt: off
UNITS: dict[str, tuple[str, float]] = {
    "s": ("time", 1.0), "sec": ("time", 1.0), "ms": ("time", 1e-3), "us": ("time", 1e-6), "µs": ("time", 1e-6),
    "ns": ("time", 1e-9), "rad": ("angle", 1.0), "mrad": ("angle", 1e-3), "deg": ("angle", math.pi / 180.0),
    "degree": ("angle", math.pi / 180.0), "degrees": ("angle", math.pi / 180.0), "grad": ("angle", math.pi / 180.0),
    "°": ("angle", math.pi / 180.0), "m": ("length", 1.0), "cm": ("length", 1e-2), "mm": ("length", 1e-3),
    "rad/s": ("angle", 1.0), "deg/s": ("angle", math.pi / 180.0), "°/s": ("angle", math.pi / 180.0),
    "m/s": ("length", 1.0), "mm/s": ("length", 1e-3), "%": ("share", 1e-2), "percent": ("share", 1e-2),
    "pct": ("share", 1e-2), "frac": ("share", 1.0),
}
# fmt: on
TIME_COLUMN_WORDS = {"t", "time", "timestamp", "stamp", "zeit", "sec", "seconds", "elapsed", "clock"}
VELOCITY_COLUMN_WORDS = {"qd", "dq", "vel", "velocity", "speed", "dot", "ds", "dtheta", "w", "omega"}
REFERENCE_COLUMN_WORDS = {
    "ref",
    "reference",
    "target",
    "desired",
    "des",
    "cmd",
    "command",
    "commanded",
    "set",
    "setpoint",
    "goal",
}
REFERENCE_COLUMN_WORDS |= {"action", "soll", "sp", "leader"}
# fmt: off
POSITION_COLUMN_WORDS = {
    "q", "pos", "position", "angle", "theta", "joint", "enc", "encoder", "actual", "state", "stroke", "s", "ist",
}
# fmt: on
COMMAND_COLUMN_WORDS = {"u", "valve", "spool", "control", "pwm", "duty", "opening"}
UNUSED_COLUMN_WORDS = {
    "tau",
    "torque",
    "torques",
    "effort",
    "i",
    "current",
    "currents",
    "amps",
    "acc",
    "accel",
    "acceleration",
}
UNUSED_COLUMN_WORDS |= {"qdd", "ddq", "temp", "temperature"}
UNUSED_COLUMN_WORDS |= {
    "moment",
    "force",
    "pressure",
    "p",
    "pa",
    "pb",
    "xt",
    "mode",
    "voltage",
    "error",
    "err",
    "index",
    "frame",
}
UNUSED_COLUMN_WORDS |= {
    "status",
    "episode",
    "task",
    "tcp",
    "speed_scaling",
    "robot",
    "safety",
    "digital",
    "reward",
    "done",
}
WHOLE_TURN_MAX_RAD = 2.0 * math.pi * 1.05


@dataclass(frozen=True, slots=True)
class ColumnGuess:
    """What a column may be: its signal, joint (a number, or a name), point, unit, and why."""

    signal: ColumnSignal
    joint: str = ""
    point: str = ""
    unit: str = ""
    reason: str = ""


def unit_factor(unit: str, signal: ColumnSignal) -> float:
    """What a number is to be multiplied by. Raises: RecordingError: no unit that this signal can have."""
    found = UNITS.get(unit.strip().lower())
    wanted = {
        "time": ("time",),
        "u": ("share", "angle", "length"),
        "x": ("length",),
        "y": ("length",),
        "z": ("length",),
    }
    if found is None or found[0] not in wanted.get(signal, ("angle", "length")):
        known = ", ".join(name for name, (kind, _) in UNITS.items() if kind in wanted.get(signal, ("angle", "length")))
        raise RecordingError(f"unit {unit!r} does not fit a column of {signal}; give one of {known}")
    return found[1]


def guess_column(name: str, unit: str, values: Array) -> ColumnGuess:
    """What a column may be."""
    bare, named_unit = _without_unit(name)
    unit = unit or named_unit
    words = _split_name_into_words(bare)
    numbers = [word for word in words if word.isdigit()]
    known = set(words)
    rest = "_".join(
        word
        for word in words
        if word not in REFERENCE_COLUMN_WORDS | POSITION_COLUMN_WORDS | VELOCITY_COLUMN_WORDS | COMMAND_COLUMN_WORDS
        and not word.isdigit()
    )
    joint = numbers[-1] if numbers else rest
    if not np.isfinite(values).any():
        return ColumnGuess("ignored", reason="holds no number")
    if known & TIME_COLUMN_WORDS and not known & (
        REFERENCE_COLUMN_WORDS | POSITION_COLUMN_WORDS | VELOCITY_COLUMN_WORDS
    ) - {"s"}:
        return _guess_time_column(unit, values)
    if known & UNUSED_COLUMN_WORDS:
        return ColumnGuess("ignored", reason="not a signal that the diagnosis uses, by its name")
    axis = next((word for word in reversed(words) if word in ("x", "y", "z")), "")
    if axis and not known & (REFERENCE_COLUMN_WORDS | VELOCITY_COLUMN_WORDS):
        point = "_".join(word for word in words if word not in ("x", "y", "z", "pos", "position")) or "point"
        return ColumnGuess(axis, point=point, unit=unit or "m", reason="a point's coordinate, by its name")  # type: ignore[arg-type]
    if known & VELOCITY_COLUMN_WORDS:
        if known & REFERENCE_COLUMN_WORDS:
            return ColumnGuess(
                "qd_ref", joint, unit=unit or _angle_unit(values, 20.0), reason="velocity reference, by its name"
            )
        return ColumnGuess("ignored", reason="a measured velocity is not used: it follows from the encoders")
    if known & COMMAND_COLUMN_WORDS and not known & (POSITION_COLUMN_WORDS - {"s"}):
        return ColumnGuess("u", joint, unit=unit or _share_unit(values), reason="command, by its name")
    if known & REFERENCE_COLUMN_WORDS:
        return ColumnGuess("q_ref", joint, unit=unit or _angle_unit(values), reason="reference, by its name")
    if known & POSITION_COLUMN_WORDS:
        return ColumnGuess("q", joint, unit=unit or _angle_unit(values), reason="encoder, by its name")
    return ColumnGuess("ignored", reason="its name is not recognised; name it in a mapping file to use it")


def _without_unit(name: str) -> tuple[str, str]:
    """The name without a unit in brackets or behind its last underscore, and the unit."""
    bracket = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]", name)
    if bracket and bracket[1].lower() in UNITS:
        return name[: bracket.start()] + name[bracket.end() :], bracket[1].lower()
    head, _, tail = name.rpartition("_")
    if head and tail.lower() in UNITS and not tail.isdigit() and tail.lower() not in ("m", "s"):
        return head, tail.lower()
    if head and tail in ("m", "s") and not re.fullmatch(r"[qu]", head):
        return head, tail
    return name, ""


def _split_name_into_words(name: str) -> list[str]:
    spaced = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return [word.lower() for word in re.findall(r"[A-Za-z]+|\d+", spaced)]


def _guess_time_column(unit: str, values: Array) -> ColumnGuess:
    if unit:
        return ColumnGuess("time", unit=unit, reason="time, by its name")
    finite = values[np.isfinite(values)]
    largest, step = float(np.abs(finite).max()), float(np.median(np.abs(np.diff(finite)))) if len(finite) > 1 else 0.0
    for least, written in ((1e17, "ns"), (1e14, "us"), (1e11, "ms")):
        if largest > least:
            return ColumnGuess("time", unit=written, reason="time since 1970, by its name and size")
    written = "s" if step < 0.5 else "ms" if step < 500.0 else "us"
    return ColumnGuess("time", unit=written, reason=f"time, by its name; unit by its step of {step:g}")


def _angle_unit(values: Array, largest_rad: float = WHOLE_TURN_MAX_RAD) -> str:
    """Degrees where an arm's radians could not be so large."""
    return "deg" if float(np.nanmax(np.abs(values))) > largest_rad else "rad"


def _share_unit(values: Array) -> str:
    return "%" if float(np.nanmax(np.abs(values))) > 1.5 else "frac"


def joint_numbers(joints: Sequence[str]) -> dict[str, int]:
    """The joints' places from 1: numbers count from the smallest, which is 0 or 1; names as they come."""
    numbers = sorted({int(joint) for joint in joints if joint.isdigit()})
    first = numbers[0] if numbers and numbers[0] in (0, 1) else 1
    out = {str(number): number - first + 1 for number in numbers}
    for joint in joints:
        if joint not in out:
            out[joint] = len(out) + 1
    return out
