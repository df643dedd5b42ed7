"""Exclusive control lease with a monotonic fencing token. Pure: the caller passes the time.

`free -> held -> stale -> held` by its holder's keep-alive, `-> held by another` by acquire (free, stale or offered) or
by a person's take. Every new holder gets a higher fencing number, so an older holder's command is always recognised.
"""

import hmac
import math
from collections import deque
from dataclasses import dataclass, field, replace
from enum import StrEnum

from server.access.errors import LeaseHeldError, LeaseLostError, LeaseStaleError, NoLeaseError, TakeRefusedError

PENDING_REQUESTS_MAX = 8  # pending hand-over requests that the holder sees; the oldest are dropped first
HANDOVER_OFFER_TTL_S = 30.0  # so long may the one that was granted control take to acquire it
ENDED_LEASES_KEPT_MAX = 64  # ended leases whose holders still get the reason


class LeaseKind(StrEnum):
    """Who holds it: a person at the machine, a fleet's program, a person who engineers."""

    OPERATOR = "operator"
    FLEET = "fleet"
    ENGINEER = "engineer"

    @property
    def is_person(self) -> bool:
        """Whether the holder is a person who sees the machine."""
        return self is not LeaseKind.FLEET


@dataclass(frozen=True, slots=True)
class Lease:
    """Control of one machine. `lease_id` is the holder's secret; times in seconds of the caller's clock."""

    lease_id: str = field(repr=False)
    owner: str
    kind: LeaseKind
    fencing: int
    ttl_s: float
    heard_s: float
    asked_by: tuple[str, ...] = ()
    offered_to: str = ""
    offered_until_s: float = -math.inf

    def expires_in_s(self, now_s: float) -> float:
        """Seconds until it is stale; 0 when it is."""
        return max(0.0, self.heard_s + self.ttl_s - now_s)

    def is_stale(self, now_s: float) -> bool:
        """Whether its holder has not been heard for its whole time."""
        return now_s >= self.heard_s + self.ttl_s

    def is_offered_to(self, owner: str, now_s: float) -> bool:
        """Whether its holder has granted it to that owner."""
        return bool(owner) and self.offered_to == owner and now_s < self.offered_until_s


class LeaseBook:
    """Mutable on purpose: the one holder of one machine. Secrets come from the caller."""

    def __init__(self, fencing: int = 0) -> None:
        self.fencing = fencing
        self.held: Lease | None = None
        self._ended: deque[tuple[str, str]] = deque(maxlen=ENDED_LEASES_KEPT_MAX)

    # --- changes of the holder --------------------------------------------------------------------------------------

    def acquire(self, owner: str, kind: LeaseKind, ttl_s: float, lease_id: str, now_s: float) -> Lease:
        """Control for `owner`, if it is free, stale or offered to them.

        Raises: LeaseHeldError: naming the holder and the time left.
        """
        held = self.held
        if held is None or held.is_stale(now_s) or held.is_offered_to(owner, now_s):
            return self._grant_lease(owner, kind, ttl_s, lease_id, now_s, f"{owner} acquired it")
        raise LeaseHeldError(
            f"{held.owner} ({held.kind}) has control for {held.expires_in_s(now_s):.0f} s more unless renewed",
            self.holder_facts(now_s),
        )

    def take_control(
        self, owner: str, kind: LeaseKind, ttl_s: float, reason: str, lease_id: str, now_s: float
    ) -> Lease:
        """Control for a person, also while another client holds it.

        Raises: TakeRefusedError: a fleet's program may not; an operator's control is never a fleet's to take.
        """
        if not kind.is_person:
            raise TakeRefusedError(
                f"{owner} is a fleet program: only a person may take control", self.holder_facts(now_s)
            )
        return self._grant_lease(owner, kind, ttl_s, lease_id, now_s, f"{owner} took it: {reason}")

    def release(self, lease_id: str, now_s: float) -> Lease:
        """End the lease, so that no client has control; returns the lease that ended. Raises as `lease_of`."""
        held = self.lease_of(lease_id, now_s)
        self._end(held, f"{held.owner} released it")
        return held

    def revoke(self, why: str) -> Lease | None:
        """End the lease of a holder who may not have it any more; returns it, None if there was none."""
        held = self.held
        if held is not None:
            self._end(held, why)
        return held

    def _grant_lease(self, owner: str, kind: LeaseKind, ttl_s: float, lease_id: str, now_s: float, why: str) -> Lease:
        if self.held is not None:
            self._end(self.held, why)
        self.fencing += 1
        self.held = Lease(lease_id, owner, kind, self.fencing, ttl_s, now_s)
        return self.held

    def _end(self, lease: Lease, why: str) -> None:
        self._ended.append((lease.lease_id, why))
        self.held = None

    # --- what the holder does ---------------------------------------------------------------------------------------

    def keep_alive(self, lease_id: str, now_s: float) -> Lease:
        """Heard again: live for another ttl_s, also from stale. Raises as `lease_of`."""
        self.held = replace(self.lease_of(lease_id, now_s), heard_s=now_s)
        return self.held

    def offer_to(self, lease_id: str, to: str, now_s: float) -> Lease:
        """Let `to` acquire it within HANDOVER_OFFER_TTL_S; until then the holder keeps it. Raises as `lease_of`."""
        held = self.lease_of(lease_id, now_s)
        self.held = replace(held, offered_to=to, offered_until_s=now_s + HANDOVER_OFFER_TTL_S)
        return self.held

    def request_control(self, owner: str) -> Lease | None:
        """Note a request for control that the holder sees; None when no client has control."""
        if self.held is None:
            return None
        others = tuple(name for name in self.held.asked_by if name != owner)
        self.held = replace(self.held, asked_by=(*others, owner)[-PENDING_REQUESTS_MAX:])
        return self.held

    # --- what a command is checked against --------------------------------------------------------------------------

    def lease_of(self, lease_id: str, now_s: float, fencing: int | None = None) -> Lease:
        """The lease of that secret, live or stale.

        Raises: LeaseLostError: it ended, and how; its fencing number is an older one. NoLeaseError: never given.
        """
        held = self.held
        if held is not None and _is_same_secret(held.lease_id, lease_id):
            if fencing is None or fencing == held.fencing:
                return held
            raise LeaseLostError(
                f"fencing number {fencing} is not this lease's ({held.fencing})", self.holder_facts(now_s)
            )
        why = next((reason for ended, reason in reversed(self._ended) if _is_same_secret(ended, lease_id)), "")
        if why or (fencing is not None and 0 < fencing <= self.fencing):
            raise LeaseLostError(
                f"control was lost: {why or 'it has ended'}; {self._control_holder_text(now_s)}",
                self.holder_facts(now_s),
            )
        raise NoLeaseError(
            f"the command carries a lease of another machine; {self._control_holder_text(now_s)}",
            self.holder_facts(now_s),
        )

    def check(self, lease_id: str, fencing: int | None, now_s: float) -> Lease:
        """The lease under which a command may move the machine.

        Raises: NoLeaseError, LeaseLostError as `lease_of`; LeaseStaleError: not kept alive.
        """
        if not lease_id or not fencing:
            raise NoLeaseError(
                f"the command carries no lease; {self._control_holder_text(now_s)}", self.holder_facts(now_s)
            )
        held = self.lease_of(lease_id, now_s, fencing)
        if held.is_stale(now_s):
            raise LeaseStaleError(
                f"control of {held.owner} is stale: not renewed for {now_s - held.heard_s:.1f} s "
                f"(limit {held.ttl_s:.1f} s)",
                self.holder_facts(now_s),
            )
        return held

    def why_lost(self, fencing: int, now_s: float) -> str:
        """Why motion under that fencing number must end now; empty while it may go on."""
        held = self.held
        if held is not None and held.fencing == fencing:
            if not held.is_stale(now_s):
                return ""
            return f"control of {held.owner} went stale: not renewed for {held.ttl_s:.1f} s"
        return f"control was lost: {self._ended[-1][1] if self._ended else 'it has ended'}"

    def holder_facts(self, now_s: float) -> dict[str, str]:
        """Who has control, as facts for programs."""
        held = self.held
        if held is None:
            return {"fencing": str(self.fencing)}
        left = f"{held.expires_in_s(now_s):.1f}"
        return {"owner": held.owner, "kind": held.kind.value, "fencing": str(held.fencing), "expires_in_s": left}

    def _control_holder_text(self, now_s: float) -> str:
        held = self.held
        if held is None:
            return "no one has control"
        return f"{held.owner} ({held.kind}) has control" + (", stale" if held.is_stale(now_s) else "")


def _is_same_secret(one: str, other: str) -> bool:
    return hmac.compare_digest(one.encode(), other.encode())
