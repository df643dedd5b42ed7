"""What this life of the server answered to which key: good for a day whatever the wall clock says in between.

Why beside the table: a computer without a battery clock begins in 1970. When its clock is set, all answers in the table
are older than a day at once, and a retry would move a second time.
"""

from dataclasses import replace

from server.store.idempotency import KEPT_S, Answered

MOST = 20_000


class GivenAnswers:
    """Bounded; the oldest go first."""

    def __init__(self) -> None:
        self._given: dict[tuple[str, str], tuple[Answered, float]] = {}

    def keep(self, mark: tuple[str, str], answered: Answered, now_mono_s: float) -> None:
        """`mark`: caller and key."""
        self._given.pop(mark, None)
        self._given[mark] = answered, now_mono_s
        if len(self._given) > MOST:
            del self._given[next(iter(self._given))]

    def find(self, mark: tuple[str, str], now_mono_s: float, now_unix_s: float) -> Answered | None:
        """As if it had been given by the present wall clock."""
        answered, at_s = self._given.get(mark, (None, 0.0))
        if answered is None or now_mono_s - at_s >= KEPT_S:
            return None
        return replace(answered, t_unix_s=now_unix_s - (now_mono_s - at_s))
