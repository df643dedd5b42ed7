"""`python -m benchmarks.diagnosis.sealed.limits --machine FILE --out FILE`: detection limits, one table a plant.

Every effect at a few sizes on one undisturbed recording, whitened for each noise level; the size at which |s|^2
reaches 24.7 lies between them on a straight line of the logarithms. Effects with a direction or a word: the geometric
mean of two shapes. A recording's own motion moves a limit by some ten per cent.
"""

import argparse
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.faults import faults_of
from benchmarks.diagnosis.sealed.plants import NAMES, OWN, Plant, plant_named
from benchmarks.diagnosis.sealed.recorded import NOISES, make
from benchmarks.diagnosis.sealed.scales import DIRECTIONS, KINDS, OPTIONS, Kind, placed
from benchmarks.diagnosis.sealed.sensitivity import (
    FOUND,
    OF_PLANT,
    Scene,
    changes,
    driven,
    encoder_signature,
    scene_of,
    signature,
    size2,
    sized,
    speed_noise_of,
)
from machine.remainder import Remainder, parse_remainders

SEED = 4242  # of the recording that the table is made on
SHARES = (0.1, 0.4, 1.6, 6.4)  # of the guess
SLOPES = (0.5, 2.0)  # of the logarithms, beyond the sizes tried
BENT = ("backlash", "payload_error")  # not in proportion to their size
Table = dict[str, list[float | None]]  # "name joint" -> limit at each noise level


def scenes(remainders: tuple[Remainder, ...], plant: Plant = OWN) -> list[Scene]:
    """The same recording at every noise level: its disturbance's part of the floor in proportion."""
    made = make(faults_of((), own.N), NOISES[0], SEED, plant)
    first = scene_of(made, NOISES[0], SEED, remainders)
    return [
        replace(
            first,
            noise=n,
            speed_noise=speed_noise_of(first) * (n.speed / NOISES[0].speed) ** 2,
            plain={},
            place=[],
        )
        for n in NOISES
    ]


def table(remainders: tuple[Remainder, ...], plant: Plant = OWN) -> Table:
    """Limits of every effect and joint."""
    levels, rng = scenes(remainders, plant), np.random.default_rng(SEED)
    levels = [replace(one, plain=levels[0].plain, place=levels[0].place) for one in levels]
    out: Table = {}
    for kind in KINDS:
        if kind.stage == "actuator":
            out |= _of_actuators(kind, levels, rng)
            continue
        for joint in kind.joints or (None,):
            out[key(kind.name, joint)] = _of_shapes(kind, joint, levels, rng)
        print(kind.name, {name: value for name, value in out.items() if name.split()[0] == kind.name}, flush=True)
    return {name: no_easier_with_less_noise(row) for name, row in out.items()}


def no_easier_with_less_noise(row: list[float | None]) -> list[float | None]:
    """Limits from the quietest level to the noisiest: what is found beside more noise is found beside less.

    Why: where a joint's own swing is far above the noise, two draws of it tell less than a third level does.
    """
    out = list(row)
    for k in range(len(out) - 2, -1, -1):
        known = [limit for limit in out[k : k + 2] if limit is not None]
        out[k] = min(known, default=None)
    return out


def key(name: str, joint: int | None) -> str:
    """A row's name."""
    return f"{name} {joint or 0}"


def _sizes(kind: Kind) -> list[float]:
    if kind.limits:
        return [float(x) for x in np.geomspace(3.0 * kind.guess, kind.largest, 6)]
    return [min(share * kind.guess, kind.largest) for share in SHARES]


def _of_actuators(kind: Kind, levels: list[Scene], rng: np.random.Generator) -> Table:
    """All joints of one actuator effect at once: each is felt by its own encoder."""
    scene, joints = levels[0], kind.joints
    strengths: dict[str, list[list[float]]] = {}
    for size in _sizes(kind):
        effects = tuple(sized(kind, placed(kind, joint, size, rng), size) for joint in joints or (None,))
        change = changes(scene, driven(scene, faults_of(effects, own.N)))
        for level in levels:
            found = encoder_signature(level, change)
            for joint in joints or (None,):
                part = found if joint is None else {"": found[f"actuator {joint}"]}
                rows = strengths.setdefault(key(kind.name, joint), [[] for _ in levels])
                rows[levels.index(level)].append(size2(part))
    used = _sizes(kind)
    out: Table = {name: [_crossing(kind, used, row) for row in rows] for name, rows in strengths.items()}
    print(kind.name, out, flush=True)
    return out


def _of_shapes(kind: Kind, joint: int | None, levels: list[Scene], rng: np.random.Generator) -> list[float | None]:
    shapes = 2 if kind.name in DIRECTIONS or kind.name in OPTIONS else 1
    sizes = _sizes(kind) if kind.stage in ("link", "controller") or kind.name in BENT else _sizes(kind)[1:2]
    found: list[list[float | None]] = []
    for _ in range(shapes):
        shaped = placed(kind, joint, kind.guess, rng)
        rows = [[size2(signature(level, sized(kind, shaped, size))) for size in sizes] for level in _once(kind, levels)]
        if len(rows) == 1:
            rows = rows * len(levels)
        found.append([_crossing(kind, sizes, row) for row in rows])
    return [_mean([one[k] for one in found]) for k in range(len(levels))]


def _once(kind: Kind, levels: list[Scene]) -> list[Scene]:
    """The levels that differ: a controller knows no noise."""
    return levels[:1] if kind.stage == "controller" and kind.name not in OF_PLANT else levels


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.exp(np.mean(np.log(known)))) if len(known) == len(values) else None


def _crossing(kind: Kind, sizes: list[float], squares: list[float]) -> float | None:
    """Where |s|^2 reaches 24.7, on straight lines of the logarithms; beyond the sizes tried, on by a bounded slope."""
    sign = -1.0 if kind.limits else 1.0  # of how strength goes with size
    order = np.argsort(sign * np.array(sizes))
    x = sign * np.log(np.array(sizes)[order])
    y = 0.5 * np.log(np.maximum(np.array(squares)[order], 1e-12) / FOUND)
    slopes = np.diff(y) / np.diff(x) if len(x) > 1 else np.ones(1)
    above = np.nonzero(y > 0.0)[0]
    if len(above) == 0:
        at = x[-1] - y[-1] / float(np.clip(slopes[-1], *SLOPES))
    elif above[0] == 0 and kind.limits:
        at = x[0]  # a weaker limit may never be reached
    elif above[0] == 0:
        at = x[0] - y[0] / float(np.clip(slopes[0], *SLOPES))
    else:
        k = int(above[0])
        at = x[k] - y[k] / float(slopes[k - 1])
    size = max(float(np.exp(sign * at)), kind.least)
    weaker = size > kind.largest / 0.8 if kind.limits else size < 0.8 * kind.largest
    return size if weaker else None


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machine", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--plant", choices=NAMES, default="own")
    given = parser.parse_args()
    remainders = parse_remainders(tomllib.loads(given.machine.read_text(encoding="utf-8")).get("remainder"))
    given.out.write_text(json.dumps(table(remainders, plant_named(given.plant)), indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
