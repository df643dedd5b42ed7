"""Files of this computer: text that a user wrote, and files that must survive a power cut."""

import errno
import logging
import os
import stat
from pathlib import Path

_log = logging.getLogger(__name__)

_BYTE_ORDER_MARKS = {b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}
_SAVE = "save it as UTF-8"


class EncodingError(OSError):
    """A file that is not UTF-8 text; as an OSError, since its reader says then that the file cannot be read."""


def text_of(data: bytes, name: str = "") -> str:
    """The text in a file's bytes: UTF-8, with or without the byte order mark that editors of Windows write.

    Raises: EncodingError: another encoding; says which, or where, and what to do.
    """
    wide = _BYTE_ORDER_MARKS.get(data[:2]) or ("UTF-16" if b"\0" in data else "")
    if wide:
        raise EncodingError(errno.EILSEQ, f"it is {wide} text or not text at all; {_SAVE}", name)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = data.count(b"\n", 0, error.start) + 1, data[error.start]
        why = f"line {line} holds byte 0x{byte:02x}, which is not UTF-8 (Latin-1 or Windows-1252?); {_SAVE}"
        raise EncodingError(errno.EILSEQ, why, name) from error


def read_text(path: Path) -> str:
    """The text of a file that a user wrote.

    Raises: OSError, with `strerror` for the user: not there, not readable, or not UTF-8.
    """
    return text_of(path.read_bytes(), str(path)).replace("\r\n", "\n")


def write_durably(path: Path, content: str | bytes, *, private: bool = False) -> None:
    """Write a file whole: after a kill or a power cut there is the file of before or this one, once it returned this.

    A file that is replaced keeps owner and mode; a new `private` one is readable by its owner only. A link goes on
    pointing to what it points to; what is not a regular file (a pipe, a terminal) is written to as it is.

    Raises: OSError: it was not written; the file of before is there.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    place = Path(os.path.realpath(path))
    before = place.stat() if place.exists() else None
    if before is not None and not stat.S_ISREG(before.st_mode):
        place.write_bytes(data)
        return
    fresh = place.with_name(place.name + ".part")
    fresh.unlink(missing_ok=True)
    mode = 0o600 if private or before is not None else 0o666
    try:
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(data)
            if before is not None:
                _keep_owner(fresh, before)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(place)
    except BaseException:
        fresh.unlink(missing_ok=True)
        raise
    sync_folder(place.parent)


def _keep_owner(fresh: Path, before: os.stat_result) -> None:
    """Owner and mode of the file that is replaced: root's `keys revoke` must leave it readable to the server's user."""
    if os.name != "posix":
        return
    try:
        os.chown(fresh, before.st_uid, before.st_gid)
    except OSError:  # only root gives files away; the mode is not widened for another group then
        _log.warning("%s: owner %s:%s could not be kept", fresh, before.st_uid, before.st_gid)
        return
    fresh.chmod(stat.S_IMODE(before.st_mode))


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on disk: a file's own fsync does not promise that it can be found."""
    if os.name != "posix":
        return  # Windows opens no folders
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(held)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a file system without it: nothing more can be done
            raise
    finally:
        os.close(held)
