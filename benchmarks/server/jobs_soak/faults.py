"""Which fault a job gets and when: drawn once from the seed and the job's number, so that a resumed run is the same."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim_plc.camera.faults import FaultKind
from sim_plc.relay.faults import Faults

Kind = Literal["none", "bad link", "cut", "camera", "cancelled", "stopped", "killed PLC"]
SHARES: dict[Kind, float] = {
    "none": 0.40,
    "bad link": 0.15,
    "cut": 0.10,
    "camera": 0.15,
    "cancelled": 0.10,
    "stopped": 0.05,
    "killed PLC": 0.05,
}
HARMLESS: frozenset[Kind] = frozenset({"none", "bad link"})  # such a job must end well all the same
BAD_LINK = Faults(
    loss_frac=0.02,
    duplicate_frac=0.02,
    reorder_frac=0.02,
    delay_ms=2.0,
    jitter_ms=8.0,
    corrupt_frac=0.005,
    replay_frac=0.005,
)
CUT = Faults(loss_frac=1.0)
_CAMERA = tuple(kind for kind in FaultKind if kind is not FaultKind.NONE)


@dataclass(frozen=True, slots=True)
class Planned:
    """One job's fault. `at_s` after the job's start; `for_s` of those that end by themselves."""

    kind: Kind
    at_s: float
    for_s: float
    camera: str = ""

    @property
    def text(self) -> str:
        """For people."""
        return f"{self.kind} ({self.camera})" if self.camera else self.kind


def planned(seed: int, number: int, span_s: float) -> Planned:
    """The fault of a job; `span_s`: within which it falls, about a job's usual length."""
    rng = np.random.default_rng([seed, number])
    kinds = list(SHARES)
    kind = kinds[int(rng.choice(len(kinds), p=list(SHARES.values())))]
    at_s, for_s, picture = (float(rng.uniform(low, high)) for low, high in ((0.0, span_s), (0.5, 3.0), (0.0, 1.0)))
    camera = _CAMERA[int(picture * len(_CAMERA))].value if kind == "camera" else ""
    return Planned(kind, 0.0 if kind == "bad link" else at_s, for_s, camera)
