"""Counters of the PC's end of the link."""

from dataclasses import dataclass


@dataclass(slots=True)
class ClientCounters:
    """What this end has seen."""

    sent: int = 0
    received: int = 0
    lost: int = 0
    stale: int = 0  # duplicates and late ones
    bad: int = 0
    rejected: int = 0
