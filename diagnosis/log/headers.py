"""Column names of a folder of CSV files against the format: unknown and half-missing ones are named."""

import csv
import re
from pathlib import Path

from diagnosis.log.findings import Finding
from diagnosis.log.nearest import did_you_mean
from recording.folder import WRONG_SEPARATOR_NAMES, column_finder
from recording.rows import CSV_ROW_TYPES, Row, csv_fields

HEADER_CHARS_MAX = 1 << 16  # characters: hundreds of joints; a file without line ends is not read to its end


def header_findings(folder: Path) -> list[Finding]:
    """Unknown columns with the nearest known name; gaps in the count of joints; unknown files."""
    findings: list[Finding] = []
    for row_type in CSV_ROW_TYPES:
        path = folder / row_type.file
        if path.is_file():
            findings += _of_file(path, row_type)
    known = {row_type.file for row_type in CSV_ROW_TYPES}
    for path in sorted(folder.glob("*.csv")):
        if path.name not in known:
            text = f"is not a file of the format and was not read{did_you_mean(path.name, known)}"
            findings.append(Finding("unknown_column", "note", path.name, text))
    return findings


def metre_findings(folder: Path, sliding: tuple[bool, ...]) -> list[Finding]:
    """Columns in m of joints that turn: only what slides has a position in m."""
    findings: list[Finding] = []
    for row_type in CSV_ROW_TYPES:
        path = folder / row_type.file
        for name in _read_header(path)[0] if path.is_file() else ():
            joints = [int(match[1]) for _, pattern in csv_fields(row_type) if (match := _in_metres(pattern, name))]
            if joints and not (joints[0] <= len(sliding) and sliding[joints[0] - 1]):
                text = (
                    f"column {name!r} is in m, but joint {joints[0]} of the machine file turns; write rad, or its type"
                )
                findings.append(Finding("metres", "fatal", path.name, f'{text} = "prismatic"'))
    return findings


def _in_metres(pattern: str, name: str) -> re.Match[str] | None:
    """The joint (group 1) of a column that the format has in rad, where it is written in m."""
    if "_rad" not in pattern or "_rad" in name:
        return None
    return column_finder(pattern).fullmatch(name)


def _read_header(path: Path) -> tuple[list[str], bool]:
    """A file's column names, and whether there is a row below them."""
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        first, second = file.readline(HEADER_CHARS_MAX), file.readline(HEADER_CHARS_MAX)
        if first.count('"') % 2:  # a quote that is never closed: reading it says so
            return [], True
        reader = csv.reader([line for line in (first, second) if line])
        try:
            names = [name.strip().removeprefix("\ufeff") for name in next(reader, [])]
            return names, next(reader, None) is not None
        except csv.Error:  # reading it says so
            return [], True


def _of_file(path: Path, row_type: type[Row]) -> list[Finding]:
    names, rows = _read_header(path)
    no_text = any("\ufffd" in name or "\0" in name for name in names)
    if no_text or (len(names) == 1 and any(separator in names[0] for separator in WRONG_SEPARATOR_NAMES)):
        return []  # reading it says so
    if names and not rows:
        text = "holds column names and no rows; record it again, or remove the file"
        return [Finding("no_rows", "problem", path.name, text)]
    patterns = [pattern for _, pattern in csv_fields(row_type)]
    finders = [column_finder(known) for known in patterns]
    findings = [
        _unknown_column_finding(path, name, did_you_mean(name, _expand_joint_patterns(patterns)))
        for name in names
        if name and not any(finder.fullmatch(name) for finder in finders)
    ]
    for pattern, finder in zip(patterns, finders, strict=True):
        joints = {int(match[1]) for name in names if "{j}" in pattern and (match := finder.fullmatch(name))}
        absent = sorted(set(range(1, max(joints, default=0) + 1)) - joints)
        if absent:
            text = f"column {pattern.replace('{j}', str(absent[0]))!r} is missing between its neighbours; add it"
            findings.append(Finding("missing_column", "fatal", path.name, text))
    own = [name for name in names if name and not any(finder.fullmatch(name) for finder in finders)]
    for name in sorted({name for name in own if own.count(name) > 1}):  # of those of the format reading says so
        findings.append(Finding("unknown_column", "problem", path.name, f"column {name!r} is there twice; remove one"))
    return findings


def _unknown_column_finding(path: Path, name: str, nearest: str) -> Finding:
    """A column of a user's own is allowed; one that nearly has a known name may be that one, misspelt."""
    return Finding(
        "unknown_column", "problem" if nearest else "note", path.name, f"column {name!r} was not read{nearest}"
    )


def _expand_joint_patterns(patterns: list[str]) -> set[str]:
    return {pattern.replace("{j}", str(j)) for pattern in patterns for j in range(1, 10)}
