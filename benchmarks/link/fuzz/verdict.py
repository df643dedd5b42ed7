"""What an oracle expects of one datagram, and one way in which an end did otherwise."""

from dataclasses import dataclass
from enum import Enum

from protocol.codes import RejectCode


@dataclass(frozen=True, slots=True)
class Breach:
    """A rule that a datagram breaks: the code that answers it, the byte of the field, and how sure the oracle is.

    Not `sure`: the number lies so near to its limit that rounding decides.
    """

    code: RejectCode
    offset: int = 0
    sure: bool = True


class Kind(Enum):
    """What becomes of a datagram."""

    TAKEN = "taken"
    SILENT = "silent"  # dropped without a word: duplicate or late
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Verdict:
    """`may`: the answers that are right for a refusal; where TAKEN is expected, rounding may make one of them right."""

    kind: Kind
    may: frozenset[tuple[int, int]] = frozenset()


TAKEN = Verdict(Kind.TAKEN)
SILENT = Verdict(Kind.SILENT)


def refused(*breaches: Breach) -> Verdict:
    """A refusal for one of these."""
    return Verdict(Kind.REFUSED, frozenset((int(b.code), b.offset) for b in breaches))


@dataclass(frozen=True, slots=True)
class Violation:
    """An end did what it must not: the evidence for whoever mends it."""

    end: str
    what: str
    situation: str
    datagram: bytes

    @property
    def text(self) -> str:
        """One paragraph with the bytes in hexadecimal."""
        return f"{self.end}: {self.what} | {self.situation} | {self.datagram.hex()}"
