"""The third plant's writers of the folder form: CSV columns, machine.toml, run.toml."""

import csv
from pathlib import Path
from typing import Any

from benchmarks.diagnosis.sealed.third_arm import Array
from benchmarks.diagnosis.sealed.third_motion import Segment

DIGITS = 8


def write_csv(path: Path, columns: dict[str, Array], decimals: int | None = None) -> None:
    """One column each; times with microseconds, other floats with 8 digits or fixed decimals."""
    texts = []
    for name, values in columns.items():
        if values.dtype.kind == "f":
            form = "%.6f" if name.startswith("t_") else f"%.{decimals}f" if decimals is not None else f"%.{DIGITS}g"
            texts.append([form % value for value in values.tolist()])
        else:
            texts.append(values.tolist())
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*texts, strict=True))


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:.9g}" if isinstance(value, float) and value % 1.0 else repr(value)


def write_toml(path: Path, machine: dict[str, Any]) -> None:
    """A machine file: tables of the first level, joints and markers as lists of tables."""
    lines: list[str] = []
    for table, values in machine.items():
        if isinstance(values, list):
            for row in values:
                lines += [f"[[{table}]]", *(f"{key} = {_value(value)}" for key, value in row.items())]
            continue
        lines.append(f"[{table}]")
        lines += [f"{key} = {_value(value)}" for key, value in values.items() if not _tables(value)]
        for key, value in values.items():
            for row in value if _tables(value) else ():
                lines += [f"[[{table}.{key}]]", *(f"{name} = {_value(item)}" for name, item in row.items())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


def write_run(path: Path, name: str, segments: tuple[Segment, ...], clocks: tuple[float, float]) -> None:
    """run.toml: the best known clock offsets and the segments."""
    lines = ["[run]", f'name = "{name}"', "format_version = 1", "[clocks]"]
    lines += [f"plc_to_pc_offset_s = {clocks[0]}", f"camera_to_pc_offset_s = {clocks[1]}"]
    for segment in segments:
        lines += ["[[segment]]", f'name = "{segment.name}"', f'kind = "{segment.kind}"']
        lines += [f"t_start_plc_s = {segment.start_s:.3f}", f"t_end_plc_s = {segment.end_s:.3f}"]
        lines += [f'repeat_of = "{segment.repeat_of}"'] if segment.repeat_of else []
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
