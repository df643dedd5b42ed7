"""Lock-out after wrong keys: six failures of one address, then a minute of silence. Pure; time is an argument."""

from dataclasses import dataclass

FAILURES_MAX = 6
LOCKED_S = 60.0
ADDRESSES_MAX = 10_000  # an attacker with many addresses fills this, not the memory


@dataclass(frozen=True, slots=True)
class Failures:
    """Of one address."""

    count: int
    last_s: float


class Lockout:
    """Mutable on purpose: who failed how often."""

    def __init__(self) -> None:
        self._failed: dict[str, Failures] = {}

    def locked_s(self, address: str, now_s: float) -> float:
        """Seconds until this address may try again; 0 when it may."""
        failed = self._failed.get(address)
        if failed is None or failed.count < FAILURES_MAX:
            return 0.0
        return max(0.0, failed.last_s + LOCKED_S - now_s)

    def failed(self, address: str, now_s: float) -> None:
        """One more wrong key; a minute without one forgets the earlier ones."""
        before = self._failed.pop(address, None)
        count = before.count + 1 if before and now_s - before.last_s < LOCKED_S else 1
        self._failed[address] = Failures(count, now_s)
        if len(self._failed) > ADDRESSES_MAX:
            self._failed.pop(next(iter(self._failed)))  # the one that failed longest ago

    def passed(self, address: str) -> None:
        """A right key."""
        self._failed.pop(address, None)
