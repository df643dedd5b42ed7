"""Which case is which: the mix in blocks of twenty, noise levels, effects with sizes about their detection limits."""

from dataclasses import dataclass

import numpy as np

from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.faults import FOREIGN, Injected
from benchmarks.diagnosis.sealed.limits import Table, key
from benchmarks.diagnosis.sealed.recorded import NOISES
from benchmarks.diagnosis.sealed.scales import BY_NAME, FOREIGN_SIZES, KINDS, Kind, placed, scaled
from benchmarks.diagnosis.sealed.sensitivity import sized

BLOCK = ("none",) * 5 + ("single",) * 7 + ("double",) * 4 + ("foreign",) * 2 + ("lacking",) * 2
FACTORS = (0.5, 8.0)  # of the detection limit, drawn evenly in the logarithm
DRAWS_MAX = 25
STAGE_OF_FOREIGN = {
    "spool_rate_limit": "actuator",
    "thermal_gain_drift": "actuator",
    "gear_eccentricity": "joint",
    "cable_tug": "actuator",
    "dropped_samples": "time",
    "swapped_joints": "time",
    "loose_marker": "camera",
}


@dataclass(frozen=True)
class Drawn:
    """One effect of a case, its limit on this recording (None: foreign), its size over the limit, its stage."""

    effect: Injected
    limit: float | None
    factor: float | None
    stage: str


@dataclass(frozen=True)
class Case:
    """What one case is. `lacking`: the effect that the tool has to do without."""

    number: int
    seed: int
    mix: str
    noise: int
    effects: tuple[Drawn, ...]
    lacking: str


def mix_of(number: int, seed: int) -> str:
    """The kind of a case: every block of twenty holds the whole mix in an order of its own."""
    order = np.random.default_rng([seed, number // len(BLOCK), 7]).permutation(len(BLOCK))
    return BLOCK[int(order[number % len(BLOCK)])]


def recording_seed(number: int, seed: int) -> int:
    """Seed of a case's motion and noise."""
    return 10_000 * seed + number


def draw(number: int, seed: int, limits: Table, factor: float | None = None) -> Case:
    """One case. `limits`: the scorer's table; `factor`: a fixed size over the limit."""
    rng = np.random.default_rng([seed, number, 11])
    mix, noise = mix_of(number, seed), int(rng.integers(0, len(NOISES)))
    if mix == "none":
        return Case(number, seed, mix, noise, (), "")
    if mix == "foreign":
        return Case(number, seed, mix, noise, (_foreign(rng),), "")
    effects: list[Drawn] = []
    wanted = 2 if mix == "double" else 1
    for _ in range(DRAWS_MAX):
        one = _one(limits, noise, rng, factor, _kind_of(number, seed) if mix == "lacking" and not effects else None)
        if one is None or any((one.effect.name, one.effect.joint) == (e.effect.name, e.effect.joint) for e in effects):
            continue
        effects.append(one)
        if len(effects) == wanted:
            break
    lacking = effects[0].effect.name if mix == "lacking" and effects else ""
    return Case(number, seed, mix, noise, tuple(effects), lacking)


def _kind_of(number: int, seed: int) -> Kind:
    """Each catalogue effect in turn is the one that is lacking."""
    return KINDS[(number + 13 * seed) % len(KINDS)]


def _one(limits: Table, noise: int, rng: np.random.Generator, fixed: float | None, wanted: Kind | None) -> Drawn | None:
    kind = wanted if wanted is not None else KINDS[int(rng.integers(0, len(KINDS)))]
    joint = int(rng.choice(kind.joints)) if kind.joints is not None else None
    shaped = placed(kind, joint, kind.guess, rng)
    least = limits[key(kind.name, joint)][noise]
    if least is None:
        return None
    low, high = FACTORS
    factor = fixed if fixed is not None else float(np.exp(rng.uniform(np.log(low), np.log(high))))
    size = scaled(kind, least, factor)
    return Drawn(sized(kind, shaped, size), least, factor, kind.stage)


def _foreign(rng: np.random.Generator) -> Drawn:
    name = FOREIGN[int(rng.integers(0, len(FOREIGN)))]
    jointed, low, high = FOREIGN_SIZES[name]
    joint = int(rng.integers(1, own.N + 1)) if jointed else None
    values = {"size": float(np.exp(rng.uniform(np.log(low), np.log(high))))}
    if name == "gear_eccentricity":
        values["order"] = float(rng.integers(7, 24))
    return Drawn(Injected(name, joint, values), None, None, STAGE_OF_FOREIGN[name])


def known(name: str) -> bool:
    """Whether a name is of the catalogue."""
    return name in BY_NAME
