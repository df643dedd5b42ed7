"""A recording of either form, and a machine file, by their paths."""

from importlib.resources import files
from pathlib import Path

from machine.errors import MachineFileError
from recording.content import Recording
from recording.errors import RecordingError
from recording.files import read_text
from recording.folder import read_folder
from recording.reader import read_mcap


def read_run(path: Path) -> Recording:
    """The recording at this path: an MCAP file or a folder of CSV files.

    Raises: RecordingError when it cannot be read.
    """
    try:
        if path.is_dir():
            return read_folder(path)
        odd = path.exists() and not path.is_file()
    except OSError as error:  # a name that no file can have
        raise RecordingError(f"{str(path)[:60]} cannot be opened: {error.strerror}") from error
    if odd:
        raise RecordingError(f"{path} is neither a file nor a folder; give an MCAP file or a folder of CSV files")
    return read_mcap(path)


def text_of_machine(path: Path) -> str:
    """The text of a machine file. Raises: MachineFileError: it is not there, cannot be read, or is not UTF-8 text."""
    try:
        return read_text(path)
    except OSError as error:
        raise MachineFileError(f"machine file {path} cannot be read: {error.strerror}; give another one") from error


def shipped_machine(name: str) -> Path:
    """Where a machine of that name would be shipped."""
    return Path(str(files("machine"))) / "machines" / f"{name}.toml"


def file_of_machine(given: Path | None) -> Path | None:
    """The shipped machine file for a name such as `hiab033`; else the given path."""
    if given is None or given.exists() or given.name != str(given):
        return given
    shipped = shipped_machine(str(given))
    return shipped if shipped.is_file() else given
