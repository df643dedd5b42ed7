"""Where the URDF of a machine file lies: among the recording's files, else next to the machine file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from diagnosis.errors import DiagnosisError
from recording.content import Attachment
from recording.files import read_text, text_of

ENDING = ".urdf"
SHOWN = 6


@dataclass(frozen=True, slots=True)
class UrdfFiles:
    """`recorded`: the recording's attachments. `folder`: the machine file's folder, if there is one."""

    recorded: Sequence[Attachment] = ()
    folder: Path | None = None

    def urdf_text(self, file: str) -> str | None:
        """The URDF of that name, whatever folder its machine file has it in; None where there is none.

        Raises: DiagnosisError: it is there and cannot be read.
        """
        name = PureWindowsPath(file).name  # cuts at both kinds of slashes
        path = None if self.folder is None else self.folder / name
        try:
            for attachment in self.recorded:
                if attachment.name == name:
                    return text_of(attachment.data)
            return read_text(path) if path is not None and path.is_file() else None
        except OSError as error:
            raise DiagnosisError(f"the URDF {name} cannot be read: {error.strerror}") from error

    def why_none(self, file: str) -> str:
        """That it is not there, where it was looked for, and which URDFs there are."""
        places = "the recording" if self.folder is None else "the recording or next to the machine file"
        known = sorted({file.name for file in self.recorded if file.name.endswith(ENDING)} | self._in_folder())
        there = f"there is {', '.join(known[:SHOWN])}: give its name in [urdf] file" if known else "put it there"
        return f"the URDF {file!r} is not in {places}; {there}"

    def _in_folder(self) -> set[str]:
        try:
            return set() if self.folder is None else {path.name for path in self.folder.glob(f"*{ENDING}")}
        except OSError:
            return set()
