"""One chunk of fuzzing: a number of datagrams into one end, the same ones for the same seed and corpus."""

from collections.abc import Sequence
from random import Random
from typing import Literal

from machine.description import Machine
from protocol.limits import limits_of
from sim_plc.fuzz.client_fuzz import ClientFuzz
from sim_plc.fuzz.corpus import Corpus
from sim_plc.fuzz.counts import FuzzCounts
from sim_plc.fuzz.plc_fuzz import PlcFuzz

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

    `kept` and `signatures`: what earlier chunks have found; `seed` names the chunk's own random stream.
    """
    rng = Random(seed)
    corpus = Corpus(rng, tuple(kept), signatures)
    if end == "plc":
        return PlcFuzz(machine, rng, corpus).run(n), corpus.found
    return ClientFuzz(limits_of(machine.joints), rng, corpus).run(n), corpus.found
