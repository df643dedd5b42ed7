"""The machine file with the diagnosed effects, for the simulator and the server."""

from pathlib import Path

from diagnosis.budget import Budget
from diagnosis.errors import DiagnosisError
from diagnosis.search.candidates import in_words
from machine.effects.entries import entries_to_toml
from machine.errors import MachineFileError
from machine.file_tables import with_room_for_effects, with_tables
from recording.errors import RecordingError
from recording.files import write_durably
from recording.machine_files import text_of_machine
from recording.opening import read_run


class MachineOutError(Exception):
    """A diagnosis from which no machine file must be made, or a file that cannot be written."""


def require_room(text: str) -> None:
    """That effects can be added to a machine file's text: to be asked before a diagnosis, not after it.

    Raises: MachineOutError.
    """
    try:
        with_room_for_effects(text)
    except MachineFileError as error:
        raise MachineOutError(str(error)) from error


def machine_with_effects(text: str, found: Budget) -> str:
    """A machine file's text with the effects found behind it; its baseline, if it has one, stays.

    Raises: MachineOutError: no effect is confirmed though there is a gap; or the text cannot be added to.
    """
    if not found.confirmed_effects and found.verdict != "none":
        raise MachineOutError(
            f"no effect is confirmed ({found.verdict_reason}): no machine file is written; do the next experiment and "
            "diagnose both recordings together"
        )
    line = f"\n# longreach diagnose: verdict {found.verdict}, {found.verdict_reason}\n"
    try:
        return with_tables(with_room_for_effects(text), line + entries_to_toml(found.effect_entries()))
    except (DiagnosisError, MachineFileError) as error:
        raise MachineOutError(str(error)) from error


def machine_text(recording: Path, machine_file: Path | None) -> str:
    """The text of a machine file: the one given, else what the recording (a folder or an MCAP file) holds.

    Raises: MachineOutError: the recording or the machine file cannot be read.
    """
    try:
        return read_run(recording).machine_toml if machine_file is None else text_of_machine(machine_file)
    except (RecordingError, MachineFileError) as error:
        raise MachineOutError(str(error)) from error


def write_machine(text: str, found: Budget, path: Path) -> str:
    """Write the file; what was written, for the screen.

    Raises: MachineOutError: see `machine_with_effects`; or the file cannot be written.
    """
    try:
        write_durably(path, machine_with_effects(text, found))
    except OSError as error:
        raise MachineOutError(f"{path} cannot be written: {error.strerror}") from error
    names = ", ".join(in_words(effect.name, effect.joint) for effect in found.effect_entries()) or "no effect"
    return f"{path}: the machine with {names}"
