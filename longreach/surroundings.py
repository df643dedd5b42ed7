"""Environment of a command's process and its children, set before anything else."""

import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import machine

LOOPBACK = ("127.0.0.1", "localhost", "::1")
CACHE = "NUMBA_CACHE_DIR"


def prepare() -> None:
    """No import from the working folder, no proxy in front of this computer itself, a place for compiled code."""
    os.environ["PYTHONSAFEPATH"] = "1"  # read by every Python that is started from here
    for name in ("no_proxy", "NO_PROXY"):  # urllib reads the first of them that is there
        given = os.environ.get(name, "")
        os.environ[name] = ",".join(dict.fromkeys([*filter(None, given.split(",")), *LOOPBACK]))
    if not any(_writable(folder) for folder in _cache_folders()):
        os.environ[CACHE] = str(_temporary_cache())
        sys.stderr.write(
            f"longreach: compiled code is kept in {os.environ[CACHE]}, because neither the program's folder nor a "
            f"cache of this user can be written; {CACHE} names a lasting folder\n"
        )


def _cache_folders() -> Iterator[Path]:
    """Where numba keeps compiled code, in its order."""
    if given := os.environ.get(CACHE):
        yield Path(given)
    yield Path(machine.__file__).parent / "__pycache__"
    user = "~/Library/Caches" if sys.platform == "darwin" else os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    yield Path(os.path.expanduser(user)) / "numba"


def _writable(folder: Path) -> bool:
    if not folder.is_absolute():  # a home that is not known
        return False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _temporary_cache() -> Path:
    """The same for every start of this user, of no other one: what is in it is run."""
    if not hasattr(os, "getuid"):  # Windows: the folder for temporary files is the user's own
        return Path(tempfile.gettempdir()) / "longreach-numba"
    folder = Path(tempfile.gettempdir()) / f"longreach-numba-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if ours else Path(tempfile.mkdtemp(prefix="longreach-numba-"))
