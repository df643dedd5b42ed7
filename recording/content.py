"""A recording in memory: rows by kind, and the files that come with it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from recording.errors import RecordingError
from recording.rows import Row
from recording.run import RunInfo

AnyRow = TypeVar("AnyRow", bound=Row)


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One line of the run's log."""

    t_utc_ns: int
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file that comes with the recording."""

    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Recording:
    """Everything numeric of one run. Images stay in the MCAP file and are only counted."""

    storage_format: Literal["mcap", "folder"]
    run_info: RunInfo
    machine_toml: str
    rows: tuple[Row, ...]
    log_entries: tuple[LogEntry, ...] = ()
    attachments: tuple[Attachment, ...] = ()
    metadata: tuple[tuple[str, str], ...] = ()
    n_images: int = 0
    complete: bool = True  # False: the MCAP file was cut, what could be read was read
    foreign_channels: tuple[str, ...] = ()  # channels of an MCAP file that are not of this format, in words

    def of(self, row_type: type[AnyRow]) -> tuple[AnyRow, ...]:
        """The rows of one kind, in order."""
        return tuple(row for row in self.rows if isinstance(row, row_type))

    def attachment(self, name: str) -> bytes | None:
        """An attachment's bytes; None when there is none of this name."""
        found = [attachment.data for attachment in self.attachments if attachment.name == name]
        return found[-1] if found else None


def column(rows: Sequence[Row], name: str) -> NDArray[np.float64]:
    """One numeric field of rows of one kind: (n,), or (n, joints) for tuples. Missing values are NaN.

    Raises: RecordingError when the field is not there, not numeric, or its rows differ in length.
    """
    if not rows:
        return np.zeros(0)
    if name not in {field.name for field in fields(rows[0])}:
        raise RecordingError(f"{type(rows[0]).__name__} has no field '{name}'")
    values = [getattr(row, name) for row in rows]
    lengths = {len(value) for value in values if isinstance(value, tuple)}
    if len(lengths) > 1:
        raise RecordingError(f"{type(rows[0]).__name__}.{name}: rows have {sorted(lengths)} values; all must be alike")
    try:
        return np.array(values, dtype=float)
    except (ValueError, TypeError) as error:
        raise RecordingError(f"{type(rows[0]).__name__}.{name} is not numeric") from error
