"""The lease desk: the book with this process' clock and secrets, and who wants to know when control changes.

A fencing number is on disk before its holder gets it (server/api/lease.py), so it is never given twice after a crash.
"""

import secrets
from collections.abc import Callable

from recording.clock import mono_s
from server.access.lease import Lease, LeaseBook, LeaseKind

LEASE_TTL_S = 10.0  # three keep-alives may be lost when they come every third of it


class LeaseDesk:
    """Where REST, WebSocket and the engine ask for control."""

    def __init__(self, fencing: int = 0, clock: Callable[[], float] = mono_s) -> None:
        self.book = LeaseBook(fencing)
        self._clock = clock
        self._still: Callable[[], bool] = _always_admitted
        self._listeners: list[Callable[[], None]] = []

    def on_change(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call when the holder changes; the answer unsubscribes."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    @property
    def now_s(self) -> float:
        """Now, on the book's clock."""
        return self._clock()

    @property
    def held(self) -> Lease | None:
        """The lease, live or stale."""
        return self.book.held

    def acquire(self, owner: str, kind: LeaseKind = LeaseKind.OPERATOR, ttl_s: float = LEASE_TTL_S) -> Lease:
        """As LeaseBook.acquire, with a new secret."""
        return self._announce_new_holder(self.book.acquire(owner, kind, ttl_s, new_lease_id(), self.now_s))

    def take_control(self, owner: str, kind: LeaseKind, reason: str, ttl_s: float = LEASE_TTL_S) -> Lease:
        """As LeaseBook.take_control, with a new secret."""
        return self._announce_new_holder(self.book.take_control(owner, kind, ttl_s, reason, new_lease_id(), self.now_s))

    def bind_lease_to_admission(self, still: Callable[[], bool]) -> None:
        """The present holder came by this admission: when `still` is over (key, session, role), so is their control."""
        self._still = still

    def expel_unadmitted(self) -> Lease | None:
        """Take control from a holder who would not be admitted now; the lease that ended, if one did."""
        if self.book.held is None or self._still():
            return None
        return self.revoke(f"the key of {self.book.held.owner} is no longer valid, or the session has ended")

    def revoke(self, why: str) -> Lease | None:
        """As LeaseBook.revoke."""
        ended = self.book.revoke(why)
        return None if ended is None else self._notify_listeners(ended)

    def release(self, lease_id: str) -> Lease:
        """As LeaseBook.release."""
        return self._notify_listeners(self.book.release(lease_id, self.now_s))

    def keep_alive(self, lease_id: str) -> Lease:
        """As LeaseBook.keep_alive."""
        return self.book.keep_alive(lease_id, self.now_s)

    def request_control(self, owner: str) -> Lease | None:
        """As LeaseBook.request_control."""
        return self.book.request_control(owner)

    def offer_to(self, lease_id: str, to: str) -> Lease:
        """As LeaseBook.offer_to."""
        return self.book.offer_to(lease_id, to, self.now_s)

    def check(self, lease_id: str, fencing: int | None) -> Lease:
        """As LeaseBook.check: what a command that moves or arms must pass."""
        return self.book.check(lease_id, fencing, self.now_s)

    def why_lost(self, fencing: int) -> str:
        """As LeaseBook.why_lost."""
        return self.book.why_lost(fencing, self.now_s)

    def _announce_new_holder(self, lease: Lease) -> Lease:
        self._still = _always_admitted  # until the new holder's admission is known
        return self._notify_listeners(lease)

    def _notify_listeners(self, lease: Lease) -> Lease:
        for listener in tuple(self._listeners):
            listener()
        return lease


def _always_admitted() -> bool:
    return True


def new_lease_id() -> str:
    """A secret of 192 random bits."""
    return secrets.token_urlsafe(24)
