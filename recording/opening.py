"""One door for both forms."""

from pathlib import Path

from recording.content import Recording
from recording.folder import read_folder
from recording.reader import read_mcap


def read_run(path: Path) -> Recording:
    """The recording at this path: an MCAP file or a folder of CSV files.

    Raises: RecordingError when it cannot be read.
    """
    return read_folder(path) if path.is_dir() else read_mcap(path)
