"""run.toml: identity, clocks and segments of a recording."""

import json
import tomllib
from dataclasses import dataclass
from typing import Any, Literal, get_args

from recording.errors import RecordingError

FORMAT_VERSION = 1
TIME_ABSOLUTE_MAX_S = 1e20  # nanoseconds of an epoch, and no more: what is not a second is found and named later

SegmentKind = Literal[
    "repeat", "multisine", "steps", "sweep", "staircase", "workcycle", "static", "hold", "positioning"
]


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of the run on the PLC's clock; segments with the same `repeat_of` are repeats of one command."""

    name: str
    kind: SegmentKind
    t_start_plc_s: float
    t_end_plc_s: float
    repeat_of: str = ""


@dataclass(frozen=True, slots=True)
class RunInfo:
    """The content of run.toml. Offsets: t_pc = t_plc + offset, t_pc = t_camera + offset; None when not known."""

    name: str
    started_utc: str = ""
    seed: int | None = None
    plc_to_pc_offset_s: float | None = None
    camera_to_pc_offset_s: float | None = None
    pc_to_utc_offset_s: float | None = None
    segments: tuple[Segment, ...] = ()
    format_version: int = FORMAT_VERSION
    cut: bool = False  # made of a file that was cut or damaged: not all of it is here


def _toml_line(name: str, value: object) -> str:
    """One TOML line; JSON's strings and numbers are TOML's, but for escapes of two halves and an unescaped delete."""
    text = json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return f"{name} = {text}\n"


def run_to_toml(run: RunInfo) -> str:
    """run.toml text."""
    text = "[run]\n" + _toml_line("name", run.name) + _toml_line("started_utc", run.started_utc)
    if run.seed is not None:
        text += _toml_line("seed", run.seed)
    text += (
        _toml_line("format_version", run.format_version) + (_toml_line("cut", True) if run.cut else "") + "\n[clocks]\n"
    )
    for name in ("plc_to_pc_offset_s", "camera_to_pc_offset_s", "pc_to_utc_offset_s"):
        value = getattr(run, name)
        if value is not None:
            text += _toml_line(name, value)
    for segment in run.segments:
        text += "\n[[segment]]\n" + _toml_line("name", segment.name) + _toml_line("kind", segment.kind)
        text += _toml_line("t_start_plc_s", segment.t_start_plc_s) + _toml_line("t_end_plc_s", segment.t_end_plc_s)
        text += _toml_line("repeat_of", segment.repeat_of) if segment.repeat_of else ""
    return text


def run_from_toml(text: str) -> RunInfo:
    """The content of run.toml text; keys that are not ours are passed over, since others write this file too.

    Raises: RecordingError naming the field that is missing or wrong.
    """
    try:
        data = tomllib.loads(text.removeprefix("\ufeff"))  # Windows' editors write a byte order mark
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RecordingError(f"run.toml is not TOML: {error}") from error
    run, clocks = data.get("run", {}), data.get("clocks", {})
    segments = data.get("segment", [])
    if not isinstance(run, dict) or not isinstance(clocks, dict) or not isinstance(segments, list):
        raise RecordingError("run.toml: [run] and [clocks] must be tables and [[segment]] a list of tables")
    version = run.get("format_version", FORMAT_VERSION)
    if isinstance(version, bool) or not isinstance(version, int) or not 1 <= version <= FORMAT_VERSION:
        raise RecordingError(f"run.toml: format_version = {version!r}; this program reads 1..{FORMAT_VERSION}")
    seed = run.get("seed")
    return RunInfo(
        name=str(run.get("name", "")),
        started_utc=str(run.get("started_utc", "")),
        seed=seed if isinstance(seed, int) else None,
        plc_to_pc_offset_s=_optional_clock_seconds(clocks, "plc_to_pc_offset_s"),
        camera_to_pc_offset_s=_optional_clock_seconds(clocks, "camera_to_pc_offset_s"),
        pc_to_utc_offset_s=_optional_clock_seconds(clocks, "pc_to_utc_offset_s"),
        segments=tuple(_parse_segment(number, segment) for number, segment in enumerate(segments, start=1)),
        format_version=version,
        cut=run.get("cut") is True,
    )


def _validated_seconds(value: object, subject: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= TIME_ABSOLUTE_MAX_S:
        raise RecordingError(
            f"run.toml: {subject} = {repr(value)[:60]} is not a number between -{TIME_ABSOLUTE_MAX_S:g} and "
            f"{TIME_ABSOLUTE_MAX_S:g} [s]"
        )
    return float(value)


def _optional_clock_seconds(table: dict[str, Any], name: str) -> float | None:
    return None if name not in table else _validated_seconds(table[name], f"clocks.{name}")


def _parse_segment(number: int, data: Any) -> Segment:
    if not isinstance(data, dict):
        raise RecordingError(f"run.toml: segment {number} is not a table")
    kind: Any = data.get("kind")
    if kind not in get_args(SegmentKind):
        raise RecordingError(f"run.toml: segment {number}: kind = {kind!r}; one of {', '.join(get_args(SegmentKind))}")
    start = _validated_seconds(data.get("t_start_plc_s"), f"segment {number}: t_start_plc_s")
    end = _validated_seconds(data.get("t_end_plc_s"), f"segment {number}: t_end_plc_s")
    if end < start:
        raise RecordingError(f"run.toml: segment {number}: t_end_plc_s = {end} s lies before t_start_plc_s = {start} s")
    return Segment(str(data.get("name", "")), kind, start, end, str(data.get("repeat_of", "")))
