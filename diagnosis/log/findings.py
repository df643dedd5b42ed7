"""What is wrong with a recording or its machine file: named, counted, with a remedy. A result, never a traceback."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

from recording.rows import CSV_ROW_TYPES

Severity = Literal["fatal", "problem", "note"]

#: Every name a finding can have, and what it says. The names are fixed: reports and tests refer to them.
CODES: dict[str, str] = {
    "unreadable": "the recording cannot be read",
    "cut_file": "the file ends before its end",
    "format_version": "written in a version of the format that this program does not read, or an older one",
    "no_machine_file": "there is no nominal machine to compare with",
    "machine_file": "the machine file cannot be used",
    "machine_mismatch": "the machine file does not describe the arm that was recorded",
    "unknown_key": "a key of the machine file that is not read",
    "unknown_column": "a column whose name the format does not know",
    "missing_column": "a column that a stage needs",
    "no_data": "nothing that a stage could be judged by",
    "too_short": "too few rows",
    "no_rows": "a file of column names only",
    "not_a_number": "numbers are missing or infinite",
    "copied_column": "two columns of one joint that are the same to the last digit",
    "constant": "a signal that never changes while others do",
    "gap": "rows are missing",
    "bridged": "rows are missing so often that short gaps are filled by lines",
    "frozen": "old values are written again while the machine moves on",
    "clock_jump": "the clock jumps while the signals go on",
    "time_backwards": "time runs backwards",
    "duplicate_rows": "rows that are written more than once",
    "uneven_rate": "rows do not come at the rate of the machine file",
    "uneven_stamps": "stamps jitter about rows that were taken evenly",
    "degrees": "angles in degrees where radians belong",
    "percent": "commands in percent where fractions belong",
    "beyond_full": "commands beyond the full one",
    "metres": "a position in metres of a joint that turns",
    "millimetres": "lengths in millimetres where metres belong",
    "milliseconds": "times in thousandths, millionths or billionths of a second where seconds belong",
    "bar": "pressures in bar where pascals belong",
    "swapped_columns": "two joints' columns are exchanged",
    "reversed_column": "a column runs against the one that it should follow",
    "duplicate_points": "two points with the same coordinates throughout",
    "exchanged_points": "two points under each other's names",
    "outlying_points": "measured points that no model of the arm comes near",
    "lost_points": "measured points of a tracker that had lost its prism",
    "corner_order": "marker corners are not in OpenCV's order",
    "eyes_exchanged": "the left eye's rows are the right one's",
    "no_run_file": "run.toml is not there",
    "no_segments": "run.toml names no segments",
    "segments_overlap": "segments share rows, which count once: shared rows of repeats are not a second measurement",
    "empty_segment": "a segment without rows",
    "no_repeats": "no command was repeated: the noise floor is not known",
    "few_repeats": "too few repeats for a sound noise floor",
    "repeats_differ": "repeats of one command that were not driven by one command",
    "clock_offset_unknown": "the offset between two clocks is not given",
    "clock_offset_wrong": "by the offset between two clocks that is given, datagrams arrive before they were sent",
    "uneven_arrivals": "datagrams take longer at one time than at another, or two clocks drift apart",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong. "fatal": nothing can be diagnosed; "problem": data were left out; "note": it costs."""

    code: str
    severity: Severity
    subject: str
    text: str
    count: int = 1

    def __str__(self) -> str:
        """How it is printed."""
        return f"{self.subject}: {self.text}"


def fatal_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Those after which there is nothing left to diagnose."""
    return tuple(finding for finding in findings if finding.severity == "fatal")


def by_channel(finding: Finding) -> Finding:
    """The same of an MCAP file, which has a channel where a folder has a CSV file."""
    subject, text = finding.subject, finding.text
    for row_type in CSV_ROW_TYPES:
        subject, text = (part.replace(row_type.file, row_type.topic) for part in (subject, text))
    return replace(finding, subject=subject, text=text)
