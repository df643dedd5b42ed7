"""Failures of the store. Each one refuses motion: what cannot be written down is not begun."""

from server.errors import ServerError


class StoreError(ServerError):
    """The database cannot be written: read-only, full, damaged, too new, or too slow."""

    code = "store"
    hint = "see GET /readyz: free space, make the folder writable, or move a damaged database away; motion is refused"


class StoreBusyError(StoreError):
    """More is waiting to be written than the queue holds."""

    code = "store_busy"
    hint = "the disk is slower than the requests; try again in a second"
