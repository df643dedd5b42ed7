"""Hold-to-run: motion goes on only while a person keeps a button down and the page proves it, challenge by challenge.

Sans-IO: time comes as an argument. An answer counts from the moment its challenge was made, not from its arrival: a
burst of answers that a stalled network let through together renews nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass

CHALLENGE_NS = 40_000_000  # 25 a second
HOLD_SILENCE_MAX_NS = 250_000_000  # the PLC's own watchdog is as long
STOP_LATENESS_MARGIN_NS = 30_000_000  # the server's own stop comes first while the server is in time
OPEN_CHALLENGES_MAX = 16  # challenges that may still be answered: 0.64 s of them, far more than may be late
NONCE_MASK = 0xFFFF_FFFF


@dataclass(frozen=True, slots=True)
class Challenge:
    """To be answered with the complement of `nonce`, 32 bits, naming what is held."""

    seq: int
    nonce: int


def reply_to(nonce: int) -> int:
    """The right answer: one's complement in 32 bits. An echo on the way cannot give it."""
    return ~nonce & NONCE_MASK


class HoldToRun:
    """One press of the button, from down to its end. `bond` is what is held: the plan's hash, or the job's id."""

    def __init__(self, bond: str, nonce: Callable[[], int], t_ns: int) -> None:
        self._bond, self._nonce = bond, nonce
        self._asked: dict[int, tuple[int, int]] = {}
        self._seq = 0
        self._next_ns = t_ns
        self._alive_ns = t_ns
        self._ended = ""

    @property
    def why_ended(self) -> str:
        """Why the hold is over; empty while it is on. An ended hold never begins again."""
        return self._ended

    @property
    def dead_ns(self) -> int:
        """When the motion stops without this rule: a little after this rule stops it, which knows better why."""
        return self._alive_ns + HOLD_SILENCE_MAX_NS + STOP_LATENESS_MARGIN_NS

    @property
    def next_ns(self) -> int:
        """When `poll` has something to do next."""
        return min(self._next_ns, self._alive_ns + HOLD_SILENCE_MAX_NS + 1)

    def poll(self, t_ns: int) -> Challenge | None:
        """The next challenge if it is due; ends the hold when nothing good was heard for too long."""
        if self._ended:
            return None
        if t_ns - self._alive_ns > HOLD_SILENCE_MAX_NS:
            silent_ms = (t_ns - self._alive_ns) // 1_000_000
            self._ended = f"the page was silent for {silent_ms} ms (limit {HOLD_SILENCE_MAX_NS // 1_000_000} ms)"
            return None
        if t_ns < self._next_ns:
            return None
        self._next_ns = t_ns + CHALLENGE_NS
        self._seq += 1
        challenge = Challenge(self._seq, self._nonce() & NONCE_MASK)
        self._asked[challenge.seq] = (challenge.nonce, t_ns)
        self._asked.pop(challenge.seq - OPEN_CHALLENGES_MAX, None)
        return challenge

    def answer(self, seq: int, reply: int, bond: str) -> bool:
        """Take an answer in. A wrong, repeated or foreign one renews nothing."""
        asked = self._asked.get(seq)
        if self._ended or asked is None or bond != self._bond or reply != reply_to(asked[0]):
            return False
        for older in [number for number in self._asked if number <= seq]:
            del self._asked[older]
        self._alive_ns = max(self._alive_ns, asked[1])
        return True

    def release(self, reason: str) -> None:
        """The button was let go, or what stands for it is gone."""
        self._ended = self._ended or reason
