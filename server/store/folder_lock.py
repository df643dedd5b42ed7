"""One server a folder: two would take each other's jobs for interrupted ones, and write over each other's knowledge."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from server.errors import SettingsError

LOCK = "longreach.lock"


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a recordings folder, which is made if it is not there. The system lets go of it however the process ends.

    Raises: SettingsError: another server holds it, or it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise SettingsError(
            f"folder {folder} cannot be written: {error.strerror}; give another one by --runs"
        ) from error
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(held, 20).decode("ascii", "replace").strip() or "unknown"
            raise SettingsError(
                f"folder {folder} is used by another server (process {holder}); end it, or give another by --runs"
            ) from error
        except OSError as error:
            raise SettingsError(
                f"folder {folder} cannot be locked: {error.strerror}; give one on this computer's own disk by --runs"
            ) from error
        os.ftruncate(held, 0)
        os.write(held, f"{os.getpid()}\n".encode())
        yield
    finally:
        os.close(held)
