"""A machine file by its path, or by the name of one that is shipped."""

from importlib.resources import files
from pathlib import Path

from machine.errors import MachineFileError
from recording.files import read_text


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
