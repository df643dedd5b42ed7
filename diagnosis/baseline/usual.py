"""What wrong names and tests find on recordings of the undisturbed machine: later findings have to be larger."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from diagnosis.baseline.left_over import cells_of
from diagnosis.cells.behind import measurement_of
from diagnosis.known.days import JUDGED_ENOUGH
from diagnosis.reading.read import Read
from diagnosis.refusal.remainder import key_of, pattern_nats, steady_energy, tests_of
from diagnosis.refusal.shapes import shapes_of
from diagnosis.search.candidates import in_words
from diagnosis.search.cell import DRIVEN_STAGES, Cell
from diagnosis.search.score import Score, numbers_of
from diagnosis.search.search import Search, search
from machine.remainder import SHARE_MIN, USUAL_ENERGY, USUAL_NATS, Remainder, usual_name, usual_shape
from machine.rotations import Array

CHANCE_NATS = 4.5  # that the best of some dozen wrong names gains by chance: three quarters of the margin of a name
CHANCE_MORE_NATS = 2.0  # for each further number that it may choose
Progress = Callable[[str], None]
Names = dict[str, dict[str, tuple[float, float]]]
Usual = dict[tuple[str, int | None, str], dict[str, float]]


def _beyond_chance(one: Score, none: Score) -> float:
    """What a name gains over what chance gives, which is more for a name with more numbers."""
    return (one.total - none.total) / (CHANCE_NATS + CHANCE_MORE_NATS * max(0, numbers_of(one.fit) - 1))


def wrong_gains(checked: list[Read], progress: Progress) -> tuple[dict[str, float], Usual, dict[str, dict[str, float]]]:
    """On undisturbed recordings, by cell: what the best wrong name usually gains, over what chance gives; by part, the
    tests that fire and their largest sizes; by stage, names that gain more than that, and what [nats].

    Why both: a swing that changes from one motion to the next gains ten times what other names do, and a ruler made
    for it would hide all of them.
    """
    best_of: dict[str, list[float]] = {}
    names: Names = {}
    usual: Usual = {}
    for number, whole in enumerate(checked, start=1):
        progress(f"what a wrong name would gain: recording {number} of {len(checked)}")
        for cell in cells_of(whole):
            found = search(cell, further=False)
            best = max(found.scored, key=lambda one: _beyond_chance(one, found.none))
            told = " + ".join(in_words(*one.key) for one in best.fit.hypothesis)
            progress(f"  {cell.label}: {told or 'nothing'} gains {best.total - found.none.total:.3g} nats")
            best_of.setdefault(cell.label, []).append(_beyond_chance(best, found.none))
            _note_names(found, names.setdefault(cell.stage, {}))
            _note_tests(cell, found.none.held_out, usual)
    spreads = {label: max(1.0, float(np.median(gains))) for label, gains in best_of.items()}
    largest = {stage: max(s for label, s in spreads.items() if label.split()[0] == stage) for stage in names}
    return spreads, usual, {stage: _beyond(found, largest[stage]) for stage, found in names.items()}


def _note_names(found: Search, gains: dict[str, tuple[float, float]]) -> None:
    """By name what it gained at most as the only one, and over what chance gives [nats, and as a share]."""
    for one in found.scored:
        if len(one.fit.hypothesis) == 1:
            effect = one.fit.hypothesis[0]
            key, gain = usual_name(found.cell.usual_as(effect, one.fit.theta)), one.total - found.none.total
            gains[key] = max(gains.get(key, (0.0, 0.0)), (gain, _beyond_chance(one, found.none)))


def _beyond(gains: dict[str, tuple[float, float]], spread: float) -> dict[str, float]:
    """Names that gain more than chance gives, divided as every other one."""
    return {name: gain for name, (gain, share) in gains.items() if share > spread}


def _note_tests(cell: Cell, residual: Array, usual: Usual) -> None:
    left, drowned = np.clip(residual, -30.0, 30.0), {}
    for part, own in cell.by_part(left):
        place = (part.stage, part.joint, measurement_of(part))
        sizes, drowned[place] = usual.setdefault(place, {}), max(part.left_share, SHARE_MIN)  # as `usual_at` reads it
        for fired in tests_of(part, own, 1):
            sizes[key_of(fired)] = max(sizes.get(key_of(fired), 0.0), fired.size)
        sizes[USUAL_ENERGY] = max(sizes.get(USUAL_ENERGY, 0.0), steady_energy(part, own))
        sizes[USUAL_NATS] = max(sizes.get(USUAL_NATS, 0.0), pattern_nats(part, own) / drowned[place])
    for one in shapes_of(cell, left, 0.0):
        place, key = (one.stage, one.joint, one.measurement), usual_shape(one.goes_with)
        usual[place][key] = max(usual[place].get(key, 0.0), one.nats / drowned[place])


def with_usual(one: Remainder, usual: Usual, days: int) -> Remainder:
    """A joint keeps its own where enough recordings tell; all joints of a stage the same where few speak for many.

    Few do not tell what the most is that is ever left.
    """
    alike = [
        sizes
        for (stage, joint, on), sizes in usual.items()
        if (stage, on) == (one.stage, one.on) and (joint in (None, one.joint) or days < JUDGED_ENOUGH)
    ]
    told = (name for sizes in alike for name in sizes if name != USUAL_ENERGY or days >= JUDGED_ENOUGH)
    names = dict.fromkeys(told)
    return replace(one, usual=tuple((name, max(sizes.get(name, 0.0) for sizes in alike)) for name in names))


def with_spread(
    remainders: tuple[Remainder, ...], spreads: dict[str, float], names: dict[str, dict[str, float]]
) -> tuple[Remainder, ...]:
    """Remainders with the spread that brings a usual wrong name's gain down to what chance gives, and unusual names."""
    out = []
    for one in remainders:
        label = one.stage if one.stage == "link" or one.joint is None else f"{one.stage} {one.joint}"
        usual = (*one.usual, *names.get(one.stage, {}).items()) if one.stage in DRIVEN_STAGES else one.usual
        out.append(replace(one, spread=spreads.get(label, 1.0), usual=usual))
    if "structure" in spreads:
        known = tuple(names["structure"].items())
        out.append(Remainder("structure", None, "", 0.0, 0.0, (), spreads["structure"], known))
    return tuple(out)
