"""What a run of the fuzzer has seen, in numbers that add up over chunks and survive as JSON."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from benchmarks.link.fuzz.verdict import Violation

_KEPT_VIOLATIONS = 20


@dataclass(slots=True)
class FuzzCounts:
    """Of one end. `sealed`: CRC (and tag) made right again after the mutation; `n` counts fuzzed datagrams only."""

    end: str
    n: int = 0
    mutated: int = 0
    sealed: int = 0
    taken: int = 0
    silent: int = 0
    refused: int = 0
    exceptions: int = 0
    violations: int = 0
    emitted: int = 0  # datagrams of the end under test that were judged too
    seconds: float = 0.0
    codes: Counter[str] = field(default_factory=Counter)
    situations: Counter[str] = field(default_factory=Counter)  # state or phase that the datagram met
    sources: Counter[str] = field(default_factory=Counter)  # where the datagram came from
    signatures: set[str] = field(default_factory=set)
    lines: set[str] = field(default_factory=set)  # traced samples: file:line
    evidence: list[str] = field(default_factory=list)

    def blame(self, violation: Violation) -> None:
        """Count a violation; the first ones are kept with their bytes."""
        self.violations += 1
        if len(self.evidence) < _KEPT_VIOLATIONS:
            self.evidence.append(violation.text)

    def add(self, other: "FuzzCounts") -> None:
        """Take in another chunk of the same end."""
        for name in _NUMBERS:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in _TABLES:
            getattr(self, name).update(getattr(other, name))
        self.signatures |= other.signatures
        self.lines |= other.lines
        self.evidence = (self.evidence + other.evidence)[:_KEPT_VIOLATIONS]

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        numbers = {name: getattr(self, name) for name in ("end", *_NUMBERS)}
        tables = {name: dict(getattr(self, name)) for name in _TABLES}
        lists = {name: sorted(getattr(self, name)) for name in ("signatures", "lines")}
        return numbers | tables | lists | {"evidence": self.evidence}


_NUMBERS = (
    "n", "mutated", "sealed", "taken", "silent", "refused", "exceptions", "violations", "emitted", "seconds",
)  # fmt: skip
_TABLES = ("codes", "situations", "sources")


def counts_from_json(data: Mapping[str, Any]) -> FuzzCounts:
    """The counts that `as_json` gave."""
    counts = FuzzCounts(data["end"], **{name: data[name] for name in _NUMBERS})
    for name in _TABLES:
        getattr(counts, name).update(data[name])
    counts.signatures.update(data["signatures"])
    counts.lines.update(data["lines"])
    counts.evidence.extend(data["evidence"])
    return counts
