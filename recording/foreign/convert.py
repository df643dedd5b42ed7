"""A log of another system into a folder: read, chosen, shown, confirmed, written."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from recording.errors import RecordingError
from recording.files import write_durably
from recording.foreign.assemble import AssembledRecording, assemble, write_assembled
from recording.foreign.found import SourceContents
from recording.foreign.mapping import Mapping, read_mapping
from recording.foreign.ros_bag import is_ros
from recording.foreign.ros_signals import ros_found
from recording.foreign.table_files import is_table
from recording.foreign.table_signals import proposed_table_mapping, table_found

Confirm = Callable[[SourceContents, AssembledRecording], bool]


@dataclass(frozen=True, slots=True)
class ConversionResult:
    """What was read, and what was written of it."""

    source_contents: SourceContents
    assembled_recording: AssembledRecording


def is_foreign(path: Path) -> bool:
    """Whether a path is a log that has to be converted first, and not a recording of our own format."""
    return is_table(path) or is_ros(path)


def convert_foreign(
    source: Path,
    target: Path,
    urdf: Path | None,
    mapping_file: Path | None,
    confirm: Confirm,
    mapping_out: Path | None = None,
) -> ConversionResult:
    """Write a folder of what a log holds.

    Args:   confirm: shows what each topic or column was taken for, and says whether guesses may be used;
            mapping_out: the guesses go here, as a mapping file, also where they are not enough for a recording.
    Raises: RecordingError: the log cannot be read, the target exists, or the guesses were not confirmed.
    """
    if target.exists():
        raise RecordingError(f"{target} exists already; choose another name")
    mapping = Mapping() if mapping_file is None else read_mapping(mapping_file)
    if is_table(source):
        if mapping_out is not None:
            _write_mapping(mapping_out, proposed_table_mapping(source))
        found = table_found(source, mapping)
    else:
        found = ros_found(source, mapping)
        if mapping_out is not None:
            _write_mapping(mapping_out, found.proposed_mapping_toml)
    assembled = assemble(found, mapping, source.stem, urdf)
    if not confirm(found, assembled):
        names = ", ".join(entry.name for entry in found.guessed_entries)
        raise RecordingError(
            f"guessed and not confirmed: {names}; confirm by --yes, or say what each is in a mapping file (--mapping)"
        )
    write_assembled(assembled, target)
    return ConversionResult(found, assembled)


def _write_mapping(path: Path, text: str) -> None:
    try:
        write_durably(path, text)
    except OSError as error:
        raise RecordingError(f"mapping file {path} cannot be written: {error.strerror}") from error
