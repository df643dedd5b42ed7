"""One server a folder: two would take each other's jobs for interrupted ones, and write over each other's knowledge."""

import errno
import fcntl
import hashlib
import logging
import os
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from server.errors import SettingsError

log = logging.getLogger(__name__)
LOCK_FILE_NAME = "longreach.lock"
_CREDENTIALS = struct.Struct("3i")  # SO_PEERCRED: process, user, group


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a recordings folder, which is made if it is not there. The system lets go of it however the process ends.

    The folder itself is locked: that outlives the removal of all files in it. A file system that locks no folders has
    the lock of the file, which also says who holds it. A folder that was removed and made again is another one:
    on Linux its path is held as well.

    Raises: SettingsError: another server holds it, or it cannot be written.
    """
    with ExitStack() as held:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            itself = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            held.callback(os.close, itself)
            file = os.open(folder / LOCK_FILE_NAME, os.O_RDWR | os.O_CREAT, 0o644)
            held.callback(os.close, file)
        except OSError as error:
            raise SettingsError(
                f"folder {folder} cannot be written: {error.strerror}; give another one by --runs"
            ) from error
        try:
            _lock_folder(itself)
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(file, 20).decode("ascii", "replace").strip() or f"unknown, {LOCK_FILE_NAME} was removed"
            raise SettingsError(
                f"folder {folder} is used by another server (process {holder}); end it, or give another by --runs"
            ) from error
        except OSError as error:
            raise SettingsError(
                f"folder {folder} cannot be locked: {error.strerror}; give one on this computer's own disk by --runs"
            ) from error
        held.enter_context(closing(_hold_path(folder)))
        os.ftruncate(file, 0)
        os.write(file, f"{os.getpid()}\n".encode())
        yield


def _hold_path(folder: Path) -> socket.socket:
    """A socket that is bound to the path by an abstract name, which only Linux has and which ends with its process.

    The name holds the mount namespace: containers on one network may have folders of their own at the same path.

    Raises: SettingsError: another one has it.
    """
    key = f"{_mount_space()} {folder.resolve()}".encode("utf-8", "surrogateescape")
    name = f"\0longreach-{hashlib.sha256(key).hexdigest()}"
    holder = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        holder.bind(name)
        holder.listen(1)
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            log.info("the recordings folder's path cannot be held (%s): only the folder itself is", error.strerror)
            return holder
        holder.close()
        raise SettingsError(
            f"folder {folder} was removed and recreated under another server (process {_process_behind(name)}), "
            "which still uses its path; end it, or give another folder by --runs"
        ) from error
    return holder


def _mount_space() -> int:
    try:
        return os.stat("/proc/self/ns/mnt").st_ino
    except OSError:
        return 0


def _process_behind(name: str) -> str:
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as asking:
        try:
            asking.connect(name)
            found = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        except OSError:
            return "unknown"
    return str(_CREDENTIALS.unpack(found)[0])


def _lock_folder(descriptor: int) -> None:
    """Raises: BlockingIOError: another one has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError as error:  # network file systems emulate it for files only
        log.info("the recordings folder itself cannot be locked (%s): its lock file is", error.strerror)
