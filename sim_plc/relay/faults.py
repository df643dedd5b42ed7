"""One direction of a network that misbehaves: loss, bursts, copies, reordering, delay, damage, cuts. Pure and seeded.

Every class draws from a stream of its own: another share of one class leaves the pattern of the others as it was.
"""

import heapq
import random
from collections import deque
from dataclasses import dataclass, fields

_MS_NS = 1_000_000
_REMEMBERED = 512  # datagrams that may come again: 5 s of states
_BITS_MAX = 8
_STREAMS = ("loss", "burst", "duplicate", "reorder", "jitter", "corrupt", "truncate", "replay")

Windows = tuple[tuple[float, float], ...]


class FaultSettingsError(ValueError):
    """A fault's setting is out of its bounds; the text names it, its value and the bound."""


@dataclass(frozen=True, slots=True)
class Faults:
    """What happens to the datagrams of one direction; the neutral values let everything pass immediately.

    Windows are (from, until) in seconds of the channel's time.
    """

    loss_frac: float = 0.0
    burst_frac: float = 0.0  # chance that a run of losses begins with a datagram
    burst_length: int = 10  # datagrams lost in a run; after a run at least one passes
    duplicate_frac: float = 0.0
    reorder_frac: float = 0.0  # share that is held back by reorder_ms, so that later ones overtake it
    reorder_ms: float = 30.0
    delay_ms: float = 0.0
    jitter_ms: float = 0.0  # up to this much more, evenly distributed
    corrupt_frac: float = 0.0  # one to eight bits flipped
    truncate_frac: float = 0.0
    replay_frac: float = 0.0  # chance that an old datagram comes once more behind a new one
    cut_windows_s: Windows = ()  # nothing passes
    freeze_windows_s: Windows = ()  # the last datagram from before comes again and again instead

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name.endswith("_frac") and not 0.0 <= value <= 1.0:
                raise FaultSettingsError(f"{field.name} = {value}: must be 0..1")
            if field.name.endswith("_ms") and not 0.0 <= value <= 60_000.0:
                raise FaultSettingsError(f"{field.name} = {value}: must be 0..60000 ms")
            if field.name.endswith("_windows_s") and not all(a <= b for a, b in value):
                raise FaultSettingsError(f"{field.name} = {value}: a window must not end before it begins")
        if self.burst_length < 1:
            raise FaultSettingsError(f"burst_length = {self.burst_length}: must be 1 or more")


@dataclass(slots=True)
class FaultCounts:
    """What a channel has done. Every datagram taken is lost, cut, or on its way; copies and replays come on top."""

    taken: int = 0
    delivered: int = 0
    lost: int = 0  # by chance
    burst: int = 0  # lost in runs
    cut: int = 0
    duplicated: int = 0
    reordered: int = 0
    overtaken: int = 0  # delivered after a younger one, whatever the cause
    corrupted: int = 0
    truncated: int = 0
    frozen: int = 0
    replayed: int = 0

    def add(self, other: "FaultCounts") -> None:
        """Add another channel's figures."""
        for field in fields(self):
            setattr(self, field.name, getattr(self, field.name) + getattr(other, field.name))


def _is_inside_any_window(windows: Windows, t_s: float) -> bool:
    return any(a <= t_s < b for a, b in windows)


class FaultChannel:
    """Takes datagrams (`push`) and gives them back, or what has become of them, when they are due (`pop`)."""

    def __init__(self, faults: Faults, rng: random.Random) -> None:
        self.faults = faults  # may be replaced at any time; what is on its way stays on its way
        self.counts = FaultCounts()
        self._draws = {name: random.Random(rng.getrandbits(64)) for name in _STREAMS}
        self._flying: list[tuple[int, int, int, bytes]] = []
        self._pushed = self._number = self._youngest = 0
        self._burst_left, self._after_burst = 0, False
        self._before_freeze: bytes | None = None
        self._past: deque[bytes] = deque(maxlen=_REMEMBERED)

    @property
    def next_due_ns(self) -> int | None:
        """When the next datagram is due; None while none is on its way."""
        return self._flying[0][0] if self._flying else None

    def push(self, datagram: bytes, t_ns: int) -> None:
        """Take a datagram at time t_ns."""
        faults, counts = self.faults, self.counts
        counts.taken += 1
        self._pushed += 1
        if self._is_datagram_dropped(t_ns):
            return
        datagram = self._corrupt_or_truncate(self._apply_freeze_fault(datagram, t_ns))
        due_ns = self._due_ns(t_ns)
        if self._is_fault_drawn("reorder", faults.reorder_frac):
            counts.reordered += 1
            due_ns += round(faults.reorder_ms * _MS_NS)
        self._schedule_datagram(due_ns, datagram)
        if self._is_fault_drawn("duplicate", faults.duplicate_frac):
            counts.duplicated += 1
            self._schedule_datagram(self._due_ns(t_ns), datagram)
        self._replay_past_datagram(t_ns)
        self._past.append(datagram)

    def pop(self, t_ns: int) -> list[bytes]:
        """What is due by t_ns, in order of delivery."""
        due: list[bytes] = []
        flying, counts = self._flying, self.counts
        while flying and flying[0][0] <= t_ns:
            _, _, pushed, datagram = heapq.heappop(flying)
            counts.delivered += 1
            counts.overtaken += pushed < self._youngest
            self._youngest = max(self._youngest, pushed)
            due.append(datagram)
        return due

    def lose_pending(self) -> None:
        """Lose what is on its way; it counts as cut."""
        self.counts.cut += len(self._flying)
        self._flying.clear()

    def _is_fault_drawn(self, name: str, share: float) -> bool:
        return share > 0.0 and self._draws[name].random() < share

    def _is_datagram_dropped(self, t_ns: int) -> bool:
        """Whether the datagram goes no further, counted by cause."""
        faults, counts = self.faults, self.counts
        if _is_inside_any_window(faults.cut_windows_s, t_ns * 1e-9):
            counts.cut += 1
            return True
        if self._in_burst():
            counts.burst += 1
            return True
        if self._is_fault_drawn("loss", faults.loss_frac):
            counts.lost += 1
            return True
        return False

    def _in_burst(self) -> bool:
        if self._burst_left == 0:
            if self._after_burst:
                self._after_burst = False
                return False
            if not self._is_fault_drawn("burst", self.faults.burst_frac):
                return False
            self._burst_left, self._after_burst = self.faults.burst_length, True
        self._burst_left -= 1
        return True

    def _apply_freeze_fault(self, datagram: bytes, t_ns: int) -> bytes:
        if self._before_freeze is None or not _is_inside_any_window(self.faults.freeze_windows_s, t_ns * 1e-9):
            self._before_freeze = datagram
            return datagram
        self.counts.frozen += 1
        return self._before_freeze

    def _corrupt_or_truncate(self, datagram: bytes) -> bytes:
        faults, counts = self.faults, self.counts
        if datagram and self._is_fault_drawn("corrupt", faults.corrupt_frac):
            counts.corrupted += 1
            draws, broken = self._draws["corrupt"], bytearray(datagram)
            for place in draws.sample(range(8 * len(broken)), draws.randint(1, _BITS_MAX)):
                broken[place // 8] ^= 1 << place % 8
            datagram = bytes(broken)
        if datagram and self._is_fault_drawn("truncate", faults.truncate_frac):
            counts.truncated += 1
            datagram = datagram[: self._draws["truncate"].randrange(len(datagram))]
        return datagram

    def _due_ns(self, t_ns: int) -> int:
        faults = self.faults
        jitter_ms = self._draws["jitter"].random() * faults.jitter_ms if faults.jitter_ms > 0.0 else 0.0
        return t_ns + round((faults.delay_ms + jitter_ms) * _MS_NS)

    def _schedule_datagram(self, due_ns: int, datagram: bytes) -> None:
        self._number += 1
        heapq.heappush(self._flying, (due_ns, self._number, self._pushed, datagram))

    def _replay_past_datagram(self, t_ns: int) -> None:
        if self._past and self._is_fault_drawn("replay", self.faults.replay_frac):
            self.counts.replayed += 1
            self._schedule_datagram(self._due_ns(t_ns), self._past[self._draws["replay"].randrange(len(self._past))])
