"""Which process is which, found from outside: who holds a UDP port (Linux)."""

import os
from pathlib import Path

_PROC = Path("/proc")


def holder_of_udp_port(port: int, parent_pid: int) -> int | None:
    """The child of `parent_pid` that holds a UDP socket bound to this port; None if there is none."""
    sockets = {f"socket:[{inode}]" for inode in _inodes_of(port)}
    return next((pid for pid in children_of(parent_pid) if sockets & _files_of(pid)), None)


def children_of(pid: int) -> list[int]:
    """Living children of a process."""
    children = _PROC / str(pid) / "task" / str(pid) / "children"
    try:
        own = [int(text) for text in children.read_text(encoding="ascii").split()]
    except OSError:
        return []
    # processes started by a thread of it are listed under that thread
    for task in (_PROC / str(pid) / "task").iterdir():
        if task.name != str(pid):
            try:
                own += [int(text) for text in (task / "children").read_text(encoding="ascii").split()]
            except OSError:  # the thread has ended
                continue
    return own


def _inodes_of(port: int) -> list[str]:
    lines = (_PROC / "net" / "udp").read_text(encoding="ascii").splitlines()[1:]
    fields = [line.split() for line in lines]
    return [row[9] for row in fields if int(row[1].rpartition(":")[2], 16) == port]


def _files_of(pid: int) -> set[str]:
    folder = _PROC / str(pid) / "fd"
    found: set[str] = set()
    try:
        for entry in folder.iterdir():
            found.add(os.readlink(entry))
    except OSError:  # ended, or a file closed under our hands
        pass
    return found
