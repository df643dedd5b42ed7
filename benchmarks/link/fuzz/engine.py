"""One chunk of fuzzing: a number of datagrams into one end, the same ones for the same seed and corpus."""

from collections.abc import Sequence
from random import Random
from typing import Literal

from benchmarks.link.fuzz.client_fuzz import ClientFuzz
from benchmarks.link.fuzz.corpus import Corpus
from benchmarks.link.fuzz.counts import FuzzCounts
from benchmarks.link.fuzz.plc_fuzz import PlcFuzz
from machine.description import Machine
from protocol.limits import limits_of

End = Literal["plc", "client"]
ENDS: tuple[End, ...] = ("plc", "client")


def fuzz_chunk(
    end: End,
    machine: Machine,
    seed: str,
    n: int,
    kept: Sequence[bytes] = (),
    signatures: frozenset[str] = frozenset(),
) -> tuple[FuzzCounts, list[bytes]]:
    """n datagrams into one end: what was seen, and the inputs that were new.

    `kept`, `signatures`: what earlier chunks have found; `seed` names the chunk's own random stream.
    """
    rng = Random(seed)
    corpus = Corpus(rng, tuple(kept), signatures)
    if end == "plc":
        return PlcFuzz(machine, rng, corpus).run(n), corpus.found
    return ClientFuzz(limits_of(machine.joints), rng, corpus).run(n), corpus.found
