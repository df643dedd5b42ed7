"""Links and faults as they are drawn: every fourth case healthy, losing datagrams, late, or with a fault of a joint."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.diagnosis.links.recorded import JOINTS, Link
from machine.effects.entries import EffectEntry, make_entry
from machine.effects.registry import effect_of

KINDS = ("healthy", "loss", "delay", "fault")
SENT_MS, LOG_CYCLES, JITTER_S = (4, 10, 20), (1, 5, 10), (0.0, 3e-4, 1e-3)
DRIFT = 1e-4  # of the PC's clock, half the cases up to this
LOSS, DELAY_S = (0.003, 0.1), (0.002, 0.06)
LATE_AND_LOST = 0.25  # of the late ones lose datagrams, too
FAULTS = (
    ("flow_gain_error", "gain_frac", 0.02, 0.1),
    ("valve_lag", "time_constant_s", 0.01, 0.05),
    ("valve_deadband", "half_width_frac", 0.01, 0.03),
)
Key = tuple[str, int | None]


@dataclass(frozen=True)
class Drawn:
    """One case; `true`: what is to be named, which of the link are effects of the catalogue, too."""

    kind: str
    link: Link
    effects: tuple[EffectEntry, ...]
    true: tuple[Key, ...]


def draw(seed: int) -> Drawn:
    """The case of a seed."""
    rng = np.random.default_rng([seed, 22])
    kind = KINDS[seed % len(KINDS)]
    sent_ms, log_cycles = int(rng.choice(SENT_MS)), int(rng.choice(LOG_CYCLES))
    jitter_s = float(rng.choice(JITTER_S))
    drift = float(rng.uniform(-DRIFT, DRIFT)) if rng.random() < 0.5 else 0.0
    delay_s = _spread(rng, DELAY_S) if kind == "delay" else 0.0
    lossy = kind == "loss" or (kind == "delay" and rng.random() < LATE_AND_LOST)
    loss = _spread(rng, LOSS) if lossy else 0.0
    effects = (_fault(rng),) if kind == "fault" else ()
    true: list[Key] = [(one.name, one.joint) for one in effects]
    true += [("transport_delay", None)] * bool(delay_s) + [("packet_loss", None)] * lossy
    return Drawn(kind, Link(jitter_s, delay_s, drift, loss, sent_ms, log_cycles), effects, tuple(true))


def _spread(rng: np.random.Generator, between: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(between))))


def _fault(rng: np.random.Generator) -> EffectEntry:
    name, parameter, low, high = FAULTS[int(rng.integers(len(FAULTS)))]
    size = float(rng.uniform(low, high))
    sign = rng.choice([-1.0, 1.0]) if name == "flow_gain_error" else 1.0
    return entry(name, int(rng.integers(1, JOINTS + 1)), {parameter: float(sign) * size})


def entry(name: str, joint: int, values: Mapping[str, object]) -> EffectEntry:
    """An effect of the catalogue with these numbers. Raises: MachineError: it has none of that name."""
    return make_entry(effect_of(name), joint, dict(values))
