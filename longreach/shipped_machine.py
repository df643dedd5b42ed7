"""A machine file by its path, or by the name of one that is shipped, as every command takes it."""

from importlib.resources import files
from pathlib import Path


def file_of_machine(given: Path | None) -> Path | None:
    """The shipped file where a name such as `hiab033` was given that is no file here; else what was given."""
    if given is None or given.exists() or given.name != str(given):
        return given
    shipped = Path(str(files("machine"))) / "machines" / f"{given}.toml"
    return shipped if shipped.is_file() else given
