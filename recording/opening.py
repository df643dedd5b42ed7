"""One door for both forms."""

from pathlib import Path

from recording.content import Recording
from recording.errors import RecordingError
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
