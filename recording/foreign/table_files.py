"""Files of columns: CSV of any separator, TwinCAT Scope's CSV export, Parquet, MATLAB .mat up to version 7."""

import csv
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from machine.rotations import Array
from recording.errors import RecordingError
from recording.files import text_of

TABLE_FILE_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".parquet", ".mat")
COLUMN_SEPARATORS = ("\t", ";", ",", "|")
SNIFFED_BYTES = 1 << 16
HEADER_LINES_MAX = 60
TABLE_NUMBERS_MAX = 200_000_000
PARQUET_HINT = "reading Parquet needs the library pyarrow: pip install 'longreach[parquet]'"
SCOPE_HEADER_FIRST_WORD = "Data-Type"


@dataclass(frozen=True, slots=True)
class TableColumn:
    """One column: values (m,), NaN where no number is; `unit` if given; `t_s` (m,) if it has times of its own."""

    name: str
    values: Array
    unit: str = ""
    t_s: Array | None = None


def is_table(path: Path) -> bool:
    """Whether a path is a file of columns, by its ending."""
    return path.suffix.lower() in TABLE_FILE_SUFFIXES and path.is_file()


def read_table(path: Path) -> list[TableColumn]:
    """The columns of a file.

    Raises: RecordingError: not readable, not of its ending's form, without rows, or without a number.
    """
    read = {".parquet": _read_parquet_file, ".mat": _read_mat_file}.get(path.suffix.lower(), _read_text_table)
    try:
        columns = read(path)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    if not columns or not any(np.isfinite(column.values).any() for column in columns):
        raise RecordingError(f"{path} holds no column of numbers; give a table with a row of names and rows of numbers")
    return columns


def _read_text_table(path: Path) -> list[TableColumn]:
    with path.open("rb") as file:
        head = file.read(SNIFFED_BYTES)
    if not head.strip():
        raise RecordingError(f"{path} is empty; export it again")
    encoding = "utf-8-sig"
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    elif b"\0" in head:
        text_of(head, str(path))  # says what it is
    else:
        try:
            head.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            encoding = (
                "utf-8-sig" if error.start > len(head) - 4 else "cp1252"
            )  # a character cut by the end does not count
    with path.open(encoding=encoding, newline="", errors="replace") as file:
        lines = file.read(SNIFFED_BYTES).splitlines()
        file.seek(0)
        scope = _scope_separator(lines)
        if scope == " ":
            raise RecordingError(
                f"{path}: a Scope export separated by spaces, but names contain spaces; export with tabs"
            )
        if scope:
            return _parse_scope_export(csv.reader(_non_empty_lines(file), delimiter=scope), scope)
        separator = _detect_separator(lines)
        rows = (
            csv.reader(_non_empty_lines(file), delimiter=separator)
            if separator != " "
            else (line.split() for line in file)
        )
        try:
            return _parse_plain_table(path, rows, separator)
        except csv.Error as error:
            raise RecordingError(
                f"{path} is not CSV: {error}; a quote that is never closed, or no text at all"
            ) from error


def _non_empty_lines(file: Any) -> Iterator[str]:
    for line in file:
        if line.strip():
            yield line


def _detect_separator(lines: Sequence[str]) -> str:
    """What stands between columns: of those that cut most lines alike, the one that gives most columns."""
    body = [line for line in lines[:-1] or lines if line.strip()][-20:]
    scores = {}
    for separator in COLUMN_SEPARATORS:
        counts = Counter(line.count(separator) for line in body)
        usual, lines_alike = counts.most_common(1)[0]
        scores[separator] = lines_alike if usual else 0
    best = max(scores, key=lambda one: scores[one])
    return best if scores[best] > len(body) // 2 else " "


def _scope_separator(lines: Sequence[str]) -> str:
    """What stands behind the first word of a header line that only TwinCAT Scope writes; empty for other files."""
    for line in lines[:HEADER_LINES_MAX]:
        bare = line.lstrip("\ufeff\"' ")
        if bare.startswith(SCOPE_HEADER_FIRST_WORD) and len(bare) > len(SCOPE_HEADER_FIRST_WORD):
            return bare[len(SCOPE_HEADER_FIRST_WORD)]
    return ""


class _Columns:
    """Numbers of a table, row by row; what is not a number is NaN."""

    def __init__(self, width: int, to_number: Callable[[str], float]) -> None:
        self._cells = [array("d") for _ in range(width)]
        self._number = to_number
        self._count = 0

    def add(self, cells: Sequence[str]) -> None:
        for place, column in enumerate(self._cells):
            text = cells[place] if place < len(cells) else ""
            try:
                column.append(float(text))
            except ValueError:
                column.append(self._number(text))
        self._count += len(self._cells)
        if self._count > TABLE_NUMBERS_MAX:
            raise RecordingError(
                f"the table holds more than {TABLE_NUMBERS_MAX:g} numbers, the limit; cut it into parts"
            )

    def arrays(self) -> list[Array]:
        return [np.frombuffer(column, dtype=float).copy() if column else np.zeros(0) for column in self._cells]


def _with_comma(text: str) -> float:
    """A number with a decimal comma; NaN if it is not a number."""
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        return float("nan")


def _as_nan(text: str) -> float:
    return {"true": 1.0, "false": 0.0}.get(text.strip().lower(), float("nan"))


def _is_number(text: str, comma: bool) -> bool:
    return not np.isnan((_with_comma if comma else _as_nan)(text)) or _is_float_text(text)


def _is_float_text(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _parse_plain_table(path: Path, rows: Iterator[list[str]], separator: str) -> list[TableColumn]:
    """A row of names, perhaps one of units, then numbers; comments before are passed over."""
    comma = separator != ","
    header: list[str] = []
    units: list[str] = []
    table: _Columns | None = None
    for row in rows:
        if table is None:
            filled = [cell for cell in row if cell.strip()]
            numbers = sum(_is_number(cell, comma) for cell in filled)
            if not filled:
                continue
            if 2 * numbers <= len(filled):
                cells = [cell.strip().lstrip("#%").strip() for cell in row]
                cells = cells[1:] if cells and not cells[0] and len(row) > 1 and row[0].strip() in ("#", "%") else cells
                if header and len(cells) == len(header) and _are_units(cells):
                    units = cells
                else:
                    header = cells
                continue
            if len(header) < len(filled):
                raise RecordingError(
                    f"{path}: {len(row)} numbers a row under {len(header)} names; start with a row of names"
                )
            table = _Columns(len(header), _with_comma if comma else _as_nan)
        table.add(row)
    if table is None:
        raise RecordingError(f"{path} has no row of numbers")
    names = [name or f"column {number}" for number, name in enumerate(header, start=1)]
    return _uniquely_named_columns(names, table.arrays(), units or [""] * len(names))


# fmt: off
_KNOWN_UNITS = {
    "s", "ms", "us", "ns", "rad", "deg", "°", "m", "mm", "-", "%", "rad/s", "deg/s", "bar", "pa", "v", "a", "c", "nm",
}
# fmt: on


def _are_units(cells: Sequence[str]) -> bool:
    filled = [cell.strip("[]() ").lower() for cell in cells if cell]
    return bool(filled) and 2 * sum(cell in _KNOWN_UNITS for cell in filled) >= len(filled)


def _uniquely_named_columns(names: Sequence[str], arrays: Sequence[Array], units: Sequence[str]) -> list[TableColumn]:
    twice = {name for name, count in Counter(names).items() if count > 1}
    seen: Counter[str] = Counter()
    out = []
    for name, values, unit in zip(names, arrays, units, strict=True):
        seen[name] += 1
        label = f"{name} ({seen[name]})" if name in twice else name
        out.append(TableColumn(label, values, unit.strip("[]() ")))
    return out


def _parse_scope_export(rows: Iterator[list[str]], separator: str) -> list[TableColumn]:
    """Scope's export: header lines of key and value for each channel, then a time [ms] and values for each group.

    Channels of one sample time may share a time column: a key of the header stands over each time column.
    """
    header: dict[str, list[str]] = {}
    table: _Columns | None = None
    width, comma = 0, separator != ","
    for row in rows:
        cells = [cell.strip() for cell in row]
        key = cells[0]
        if table is None and not _is_number(key, comma):
            if len(cells) >= width or key not in header:
                header[key] = cells  # the project's own Name comes first and is overwritten by the channels'
                width = max(width, len(cells))
            continue
        if key == "EOF":
            break
        if table is None:
            width = max(len(cells), 2)
            table = _Columns(width, _with_comma if comma else _as_nan)
        table.add(cells)
    names = header.get("SymbolName") or header.get("Name") or []
    if table is None or len(names) < 2:
        raise RecordingError(
            "the Scope export has no values or no names; export with the header and one timeline a sample time"
        )
    return _of_scope(header, names, table.arrays(), width)


def _of_scope(header: dict[str, list[str]], names: list[str], arrays: list[Array], width: int) -> list[TableColumn]:
    label, short = names[0], header.get("Name", names)
    several = {name for name, count in Counter(names).items() if count > 1}
    names = [short[k] if name in several and name != label else name for k, name in enumerate(names)]
    clock_places = [place for place in range(min(width, len(names))) if names[place] == label]
    ticks_from = 1e15  # times are milliseconds since the first, or Windows' 100 ns ticks
    out = []
    time_s: Array | None = None
    units = header.get("Unit", [])
    for place in range(min(width, len(names))):
        if place in clock_places:
            raw = arrays[place]
            time_s = raw * 1e-7 if np.nanmax(raw, initial=0.0) > ticks_from else raw * 1e-3
            continue
        unit = units[place] if place < len(units) and units[place] not in ("None", "(None)", "Unit") else ""
        good = np.isfinite(arrays[place])
        if time_s is not None:
            good &= np.isfinite(time_s)
        out.append(TableColumn(names[place], arrays[place][good], unit, None if time_s is None else time_s[good]))
    return out


def _read_parquet_file(path: Path) -> list[TableColumn]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise RecordingError(PARQUET_HINT) from error
    try:
        file = pyarrow.parquet.ParquetFile(path)
        if file.metadata.num_rows * max(1, file.metadata.num_columns) > TABLE_NUMBERS_MAX:
            raise RecordingError(f"{path} holds more than {TABLE_NUMBERS_MAX:g} numbers, the limit; cut it into parts")
        table = file.read()
    except pyarrow.ArrowException as error:
        raise RecordingError(f"{path} is not Parquet, or damaged: {error}; write it again") from error
    out: list[TableColumn] = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        out += _arrow_column(name, column, pyarrow)
    return out


def _arrow_column(name: str, column: Any, pyarrow: Any) -> list[TableColumn]:
    kind = column.type
    types = pyarrow.types
    if types.is_timestamp(kind):
        seconds = column.cast(pyarrow.timestamp("ns")).to_numpy(zero_copy_only=False).astype("int64") * 1e-9
        return [TableColumn(name, seconds, "s")]
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        rows = [value for value in column.to_pylist()]
        width = max((len(row) for row in rows if row is not None), default=0)
        if not width or not isinstance(next((row[0] for row in rows if row), None), int | float):
            return []
        values = np.array([[*(row or ()), *[np.nan] * (width - len(row or ()))] for row in rows], dtype=float)
        return [TableColumn(f"{name}_{k}", values[:, k]) for k in range(width)]
    if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_decimal(kind):
        return [TableColumn(name, np.asarray(column.to_numpy(zero_copy_only=False), dtype=float))]
    return []


def _read_mat_file(path: Path) -> list[TableColumn]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        data = loadmat(path, simplify_cells=True)
    except NotImplementedError as error:
        raise RecordingError(f"{path} is of MATLAB 7.3 (HDF5); save it by save(..., '-v7')") from error
    except (MatReadError, ValueError, TypeError, KeyError, IndexError, OSError) as error:
        raise RecordingError(f"{path} is not a .mat file, or damaged: {error}; save it again by '-v7'") from error
    arrays = list(_nested_numeric_arrays(data, ""))
    lengths = Counter(max(values.shape) for _, values in arrays if values.size > 1)
    if not lengths:
        return []
    rows = max(lengths, key=lambda length: (lengths[length] * (length > 10), length))
    out: list[TableColumn] = []
    for name, values in arrays:
        if values.ndim == 1 and len(values) == rows:
            out.append(TableColumn(name, values.astype(float)))
        elif values.ndim == 2 and rows in values.shape:
            table = values if values.shape[0] == rows else values.T
            out += [TableColumn(f"{name}_{k}", row.astype(float)) for k, row in enumerate(table.T, start=1)]
    return [replace(column, values=np.ascontiguousarray(column.values)) for column in out]


def _nested_numeric_arrays(value: Any, name: str) -> Iterator[tuple[str, Array]]:
    """Numeric arrays of structures, by their place in it."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if not str(key).startswith("__"):
                yield from _nested_numeric_arrays(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, np.ndarray) and value.dtype.kind in "iufb" and 1 <= value.ndim <= 2:
        yield name, value
