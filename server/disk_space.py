"""How much is left where recordings and the database are written."""

import shutil
import time
from pathlib import Path

DISK_LOW_BYTES = 10**9  # half an hour of recording with pictures
DISK_CHECK_PERIOD_S = 5.0  # a look costs a system call, which a network disk may hold up


class DiskSpace:
    """Looks every few seconds however many ask."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._looked_s = float("-inf")
        self._free_bytes: int | None = None

    @property
    def free_bytes(self) -> int | None:
        """Left on the disk of that folder, or of the nearest parent that exists; None when it cannot be read."""
        now_s = time.monotonic()
        if now_s - self._looked_s >= DISK_CHECK_PERIOD_S:
            self._looked_s, self._free_bytes = now_s, _free_bytes(self._folder)
        return self._free_bytes

    @property
    def why_short(self) -> str:
        """What is wrong; empty while there is enough."""
        text = disk_shortage(self.free_bytes)
        return f"{text} in {self._folder}" if text else ""


def disk_shortage(free_bytes: int | None) -> str:
    """How little is left, with its limit; empty while there is enough, or where it is not known."""
    if free_bytes is None or free_bytes >= DISK_LOW_BYTES:
        return ""
    return f"{free_bytes / 1e6:.0f} MB left (limit {DISK_LOW_BYTES / 1e6:.0f} MB)"


def _free_bytes(folder: Path) -> int | None:
    try:
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        return shutil.disk_usage(folder).free
    except OSError:
        return None
