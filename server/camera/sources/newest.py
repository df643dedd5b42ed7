"""A box that holds one item, the newest: what a reading thread puts in, a slower worker takes out."""

import threading
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Newest(Generic[Item]):
    """One place; putting into a full box replaces and counts what was never taken."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._item: Item | None = None
        self.skipped = 0

    def put(self, item: Item) -> None:
        """Make this the newest item."""
        with self._condition:
            if self._item is not None:
                self.skipped += 1
            self._item = item
            self._condition.notify()

    def take(self, timeout_s: float) -> Item | None:
        """The newest item, taken out; None when none came in time."""
        with self._condition:
            if self._item is None:
                self._condition.wait(timeout_s)
            item, self._item = self._item, None
            return item
