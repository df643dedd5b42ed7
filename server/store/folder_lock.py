"""One server a folder: two would take each other's jobs for interrupted ones, and write over each other's knowledge."""

import fcntl
import logging
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from server.errors import SettingsError

log = logging.getLogger(__name__)
LOCK = "longreach.lock"


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a recordings folder, which is made if it is not there. The system lets go of it however the process ends.

    The folder itself is locked: that outlives the removal of all files in it. A file system that locks no folders has
    the lock of the file, which also says who holds it.

    Raises: SettingsError: another server holds it, or it cannot be written.
    """
    with ExitStack() as held:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            itself = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            held.callback(os.close, itself)
            file = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
            held.callback(os.close, file)
        except OSError as error:
            raise SettingsError(
                f"folder {folder} cannot be written: {error.strerror}; give another one by --runs"
            ) from error
        try:
            _lock_folder(itself)
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(file, 20).decode("ascii", "replace").strip() or f"unknown, {LOCK} was removed"
            raise SettingsError(
                f"folder {folder} is used by another server (process {holder}); end it, or give another by --runs"
            ) from error
        except OSError as error:
            raise SettingsError(
                f"folder {folder} cannot be locked: {error.strerror}; give one on this computer's own disk by --runs"
            ) from error
        os.ftruncate(file, 0)
        os.write(file, f"{os.getpid()}\n".encode())
        yield


def _lock_folder(descriptor: int) -> None:
    """Raises: BlockingIOError: another one has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError as error:  # network file systems emulate it for files only
        log.info("the recordings folder itself cannot be locked (%s): its lock file is", error.strerror)
