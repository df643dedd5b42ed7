"""A deadline that the server keeps moving on while motion may go on; missed, motion stops whatever the server does."""

from dataclasses import dataclass


@dataclass(slots=True)
class Deadline:
    """At most one at a time. Once missed, nothing may begin until it is set again. `missed_text`: why it stopped."""

    missed_text: str
    missed: bool = False
    _until_ns: int | None = None

    def set(self, until_ns: int | None) -> None:
        """Let motion go on until then [monotonic ns]; None: nothing needs to be proven any more."""
        self._until_ns, self.missed = until_ns, False

    def just_missed(self, now_ns: int) -> bool:
        """Whether it has passed since it was asked last."""
        if self._until_ns is None or now_ns <= self._until_ns:
            return False
        self._until_ns, self.missed = None, True
        return True
