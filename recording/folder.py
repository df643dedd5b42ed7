"""The folder form: run.toml, machine.toml and one CSV file per numeric channel."""

import csv as csv_format
import math
import os
import re
from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, get_type_hints

from recording.content import Attachment, Recording
from recording.errors import RecordingError
from recording.files import text_of
from recording.rows import CSV_ROW_TYPES, MISSING_COUNT, NAN, Floats, Row, csv_fields
from recording.run import RunInfo, run_from_toml, run_to_toml

#: What spreadsheets put between columns in place of commas, and how it is called.
WRONG_SEPARATOR_NAMES = {";": "semicolons", "\t": "tabs", "|": "bars"}
FILE_SIZE_MAX_BYTES = (
    2**31
)  # of one file: two hours of six joints at 1 kHz; what is read takes ten times as much memory
NUMBER_FORMAT_REMEDY = "write commas between columns and points in numbers"


def write_folder(recording: Recording, folder: Path) -> None:
    """Write a recording's numbers as a folder of CSV files; images and channels without a CSV form are left out."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "run.toml").write_text(run_to_toml(recording.run_info), encoding="utf-8")
        if recording.machine_toml:
            (folder / "machine.toml").write_text(recording.machine_toml, encoding="utf-8")
        for attachment in recording.attachments:
            (folder / Path(attachment.name).name).write_bytes(attachment.data)
        for row_type in CSV_ROW_TYPES:
            rows = recording.of(row_type)
            if rows:
                _write_csv(folder / row_type.file, row_type, rows)
    except OSError as error:
        raise RecordingError(f"folder {folder}: {error.strerror}; choose a folder that can be written") from error


def _is_joints(row_type: type[Row], name: str) -> bool:
    return get_type_hints(row_type)[name] == Floats


def _write_csv(path: Path, row_type: type[Row], rows: Sequence[Row]) -> None:
    header: list[str] = []
    widths: list[tuple[str, int]] = []  # field, its number of columns (0: a scalar)
    for name, pattern in csv_fields(row_type):
        if not _is_joints(row_type, name):
            header.append(pattern)
            widths.append((name, 0))
            continue
        width = max(len(getattr(row, name)) for row in rows)
        header += [pattern.replace("{j}", str(j)) for j in range(1, width + 1)]
        widths.append((name, width))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv_format.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(_cells(row, widths) for row in rows)


def _cells(row: Row, widths: list[tuple[str, int]]) -> list[str]:
    cells: list[str] = []
    for name, width in widths:
        value = getattr(row, name)
        values = (value,) if not isinstance(value, tuple) else (*value, *[NAN] * (width - len(value)))
        cells += [_cell_text(each) for each in values]
    return cells


def _cell_text(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    return "" if value == MISSING_COUNT else str(value)


def _none_in(folder: Path) -> str:
    """Error text for a folder that is not a recording, naming the recordings in it."""
    files = sorted(folder.glob("*.mcap"))
    if files:
        return f"folder {folder} is not a recording but holds {len(files)}: name one of them, such as {files[-1]}"
    return f"folder {folder} holds no recording: neither run.toml nor plc.csv, static.csv or the like"


def read_folder(folder: Path) -> Recording:
    """The recording in a folder. Every file is optional, but one of the format has to be there.

    Raises: RecordingError naming file, line, column and value.
    """
    run_file, machine_file = folder / "run.toml", folder / "machine.toml"
    known = ("run.toml", "machine.toml", *(row_type.file for row_type in CSV_ROW_TYPES))
    odd = [name for name in known if os.path.lexists(folder / name) and not (folder / name).is_file()]
    if odd:
        raise RecordingError(f"{folder / odd[0]} is a folder, a pipe or a broken link; put a file there")
    if not any((folder / name).is_file() for name in known if name != "machine.toml"):
        raise RecordingError(_none_in(folder))
    rows: list[Row] = []
    for row_type in CSV_ROW_TYPES:
        path = folder / row_type.file
        if path.is_file():
            rows += _read_csv(path, row_type)
    attached = [path for path in sorted(folder.iterdir()) if path.suffix in (".json", ".urdf") and path.is_file()]
    run = run_from_toml(_read_file_text(run_file)) if run_file.is_file() else RunInfo("")
    return Recording(
        storage_format="folder",
        run_info=run,
        machine_toml=_read_file_text(machine_file) if machine_file.is_file() else "",
        rows=tuple(rows),
        attachments=tuple(Attachment(path.name, _media_type(path), _read_file_bytes(path)) for path in attached),
        complete=not run.cut,
    )


def _read_file_text(path: Path) -> str:
    try:
        return text_of(_read_file_bytes(path))
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}") from error


def _read_file_bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > FILE_SIZE_MAX_BYTES:
            text = f"{path} has {size / 2**30:.3g} GB, limit {FILE_SIZE_MAX_BYTES / 2**30:.3g} GB"
            raise RecordingError(f"{text}; cut it into shorter recordings")
        return path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}") from error


def _media_type(path: Path) -> str:
    return "application/json" if path.suffix == ".json" else "application/xml"


def _read_csv(path: Path, row_type: type[Row]) -> list[Row]:
    reader = csv_format.reader(_read_file_text(path).splitlines())
    try:
        header = [name.strip() for name in next(reader, [])]
        take = _row_reader(path, row_type, header)
        return [take(number, cells) for number, cells in enumerate(reader, start=2) if any(cells)]
    except csv_format.Error as error:
        text = f"{path}, line {reader.line_num}: not CSV: {error}"
        raise RecordingError(f"{text}; a quote that is never closed, or no text at all") from error


def _row_reader(path: Path, row_type: type[Row], header: list[str]) -> Callable[[int, list[str]], Row]:
    hints = get_type_hints(row_type)
    places = {name: _field_column_indices(path, pattern, header) for name, pattern in csv_fields(row_type)}
    first = next(iter(places))
    if not places[first]:
        for separator, called in WRONG_SEPARATOR_NAMES.items():
            if len(header) == 1 and separator in header[0]:
                raise RecordingError(f"{path}: columns are separated by {called}; {NUMBER_FORMAT_REMEDY}")
        raise RecordingError(f"{path}: column '{csv_fields(row_type)[0][1]}' is missing; the file cannot be placed")
    quick = {name: _fast_field_parser(hints[name], at) for name, at in places.items()}

    def take(number: int, cells: list[str]) -> Row:
        values: dict[str, Any] = {}
        if len(cells) > len(header) and any(cells[len(header) :]):
            where = f"{path}, line {number}"
            raise RecordingError(
                f"{where}: {len(cells)} cells under {len(header)} column names; {NUMBER_FORMAT_REMEDY}"
            )
        for name, converted in quick.items():
            try:
                values[name] = converted(cells)
            except (ValueError, IndexError):  # missing, wrong or short: a closer look
                texts = [cells[place] if place < len(cells) else "" for place in places[name]]
                values[name] = _parse_field_value(hints[name], texts, f"{path}, line {number}, {name}")
        return row_type(**values)

    return take


def _fast_field_parser(kind: object, columns: list[int]) -> Callable[[list[str]], object]:
    """A field of a row in which all is there, as in nearly every row. Raises: ValueError, IndexError: it is not."""
    if not columns:
        missing = _parse_field_value(kind, [], "")
        return lambda _cells: missing
    column = columns[0]
    if kind is str:
        return lambda cells: cells[column].strip()
    if kind is int:
        return lambda cells: int(cells[column])
    if kind != Floats:
        return lambda cells: float(cells[column] or NAN)
    if len(columns) == 1:
        return lambda cells: _require_no_nan((float(cells[column]),))
    chosen = itemgetter(*columns)
    return lambda cells: _require_no_nan(tuple(map(float, chosen(cells))))


def _require_no_nan(numbers: Floats) -> Floats:
    if math.isnan(sum(numbers)):
        raise ValueError
    return numbers


def column_finder(pattern: str) -> re.Pattern[str]:
    """What a column's name must match: group 1 is the joint. A joint that slides may be written in m: `q_1_m`."""
    return re.compile(re.escape(pattern).replace(re.escape("{j}"), r"(\d{1,2})").replace("_rad", "_(?:rad|m)"))


def _field_column_indices(path: Path, pattern: str, header: list[str]) -> list[int]:
    """Where a field's columns are; for joints in the order of their numbers, without gaps."""
    if "{j}" not in pattern:
        there = [place for place, name in enumerate(header) if name == pattern]
        if len(there) > 1:
            raise _duplicate_column_error(path, header, there)
        return there
    finder = column_finder(pattern)
    found: dict[int, int] = {}
    for place, name in enumerate(header):
        match = finder.fullmatch(name)
        if match is not None and found.setdefault(int(match[1]), place) != place:
            raise _duplicate_column_error(path, header, [found[int(match[1])], place])
    if set(found) != set(range(1, len(found) + 1)):
        raise RecordingError(
            f"{path}: columns '{pattern}': joints {sorted(found)}; they must count from 1 without gaps"
        )
    return [found[joint] for joint in sorted(found)]


def _duplicate_column_error(path: Path, header: list[str], places: list[int]) -> RecordingError:
    """Error text for two columns of one field."""
    first, second = places[:2]
    one, other = header[first], header[second]
    where, columns = f"{path}: column", f"(columns {first + 1} and {second + 1} of the file)"
    if ("_rad" in one) != ("_rad" in other):
        return RecordingError(f"{where} '{other}' is there in two units {columns}; keep the one of the joint's type")
    both = "" if one == other else f", as '{one}' and as '{other}'"
    return RecordingError(f"{where} '{one}' is there twice{both} {columns}; rename one by what it holds, or remove it")


def _parse_field_value(kind: object, texts: list[str], where: str) -> object:
    if kind is str:
        return texts[0].strip() if texts else ""
    numbers = [_parse_number(text, where) for text in texts]
    if kind == Floats:
        return () if _all_missing(numbers) else tuple(numbers)
    if kind is int:
        missing = not numbers or math.isnan(numbers[0])
        if not missing and math.isinf(numbers[0]):
            raise RecordingError(
                f"{where}: {texts[0].strip()!r} is not a count; give a whole number, or leave it empty"
            )
        return MISSING_COUNT if missing else int(numbers[0])
    return numbers[0] if numbers else NAN


def _all_missing(numbers: Iterable[float]) -> bool:
    return all(math.isnan(number) for number in numbers)


def _parse_number(text: str, where: str) -> float:
    text = text.strip()
    if not text:
        return NAN
    try:
        return float(text)
    except ValueError as error:
        remedy = "write a point, not a comma" if "," in text else "leave a missing one empty"
        raise RecordingError(f"{where}: '{text[:40]}' is not a number; {remedy}") from error
