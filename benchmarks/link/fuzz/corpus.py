"""Inputs worth mutating again: those that made an end behave in a way not seen before, or run lines not run before."""

from random import Random

_MOST = 600


class Corpus:
    """Payloads by the order of their finding; when full, a random old one makes room."""

    def __init__(self, rng: Random, payloads: tuple[bytes, ...] = (), signatures: frozenset[str] = frozenset()) -> None:
        self._rng = rng
        self.payloads = list(payloads)
        self.signatures = set(signatures)
        self.found: list[bytes] = []  # since the beginning of this chunk
        self.lines: set[str] = set()

    def offer(self, payload: bytes, signature: str, lines: set[str]) -> bool:
        """Keep the payload if signature or lines are new; whether they are."""
        new = signature not in self.signatures or not lines <= self.lines
        self.signatures.add(signature)
        self.lines |= lines
        if new and len(payload) < 1500:
            self.found.append(payload)
            if len(self.payloads) < _MOST:
                self.payloads.append(payload)
            else:
                self.payloads[self._rng.randrange(_MOST)] = payload
        return new

    def pick(self) -> bytes | None:
        """One of the kept ones; the newest third twice as likely."""
        if not self.payloads:
            return None
        first = len(self.payloads) * 2 // 3 if self._rng.random() < 0.25 else 0
        return self.payloads[self._rng.randrange(first, len(self.payloads))]
