"""Where the URDF of a machine file lies: among the recording's files, else next to the machine file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from diagnosis.errors import DiagnosisError
from recording.content import Attachment
from recording.files import read_text, text_of

URDF_SUFFIX = ".urdf"
LISTED_FILES_MAX = 6


@dataclass(frozen=True, slots=True)
class UrdfFiles:
    """Where the URDF files of a machine are: attached to its recording, or in its machine file's folder."""

    attachments: Sequence[Attachment] = ()
    machine_file_folder: Path | None = None

    def urdf_text(self, file: str) -> str | None:
        """The URDF of that name, whatever folder its machine file has it in; None where there is none.

        Raises: DiagnosisError: it is there and cannot be read.
        """
        name = PureWindowsPath(file).name  # cuts at both kinds of slashes
        path = None if self.machine_file_folder is None else self.machine_file_folder / name
        try:
            for attachment in self.attachments:
                if attachment.name == name:
                    return text_of(attachment.data)
            return read_text(path) if path is not None and path.is_file() else None
        except OSError as error:
            raise DiagnosisError(f"the URDF {name} cannot be read: {error.strerror}") from error

    def why_none(self, file: str) -> str:
        """That it is not there, where it was looked for, and which URDFs there are."""
        places = "the recording" if self.machine_file_folder is None else "the recording or next to the machine file"
        known = sorted({file.name for file in self.attachments if file.name.endswith(URDF_SUFFIX)} | self._in_folder())
        there = (
            f"there is {', '.join(known[:LISTED_FILES_MAX])}: give its name in [urdf] file" if known else "put it there"
        )
        return f"the URDF {file!r} is not in {places}; {there}"

    def _in_folder(self) -> set[str]:
        try:
            return (
                set()
                if self.machine_file_folder is None
                else {path.name for path in self.machine_file_folder.glob(f"*{URDF_SUFFIX}")}
            )
        except OSError:
            return set()
