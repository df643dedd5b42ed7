"""From held-out scores to probabilities: within a cell, then over all cells together; equivalence classes."""

import heapq
import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import count

import numpy as np

from diagnosis.search.candidates import SET_BY_HAND, Candidate
from diagnosis.search.cell import DRIVEN_STAGES, Cell
from diagnosis.search.fit import evaluated
from diagnosis.search.margin import MARGIN_NATS
from diagnosis.search.score import Score, chosen_nats, usual_nats
from diagnosis.search.search import Search
from machine.rotations import Array

SAME_DIRECTION = 0.95
SEPARATED_NATS = 9.0  # T below it: the data cannot tell two effects apart
SHARE_MIN = 1e-3
COMBINATIONS_MAX = 40
SEEN_TOGETHER = {"structure": ("joint", "structure")}
EQUAL_NATS = 0.5
NOTHING = 1e-6  # of an effect's range
UNHEARD_NATS = 4.0  # at most, that a size beyond what machines have costs a name of another stage
BY_HEADING = ("outside_probability", "unseen_probability")
Key = tuple[str, int | None]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Frozen numbers that turn scores into probabilities. By verdict (and `sure` names): `outside_probability` of a
    foreign cause, `unseen_probability` (if it is none) of a further effect that is too small to be seen.
    """

    temperature: float
    temperature_without_floor: float
    penalty_nats_per_effect: float
    foreign_stage_penalty_nats: float
    outside_probability: tuple[tuple[str, float], ...]
    unseen_probability: tuple[tuple[str, float], ...]


@cache
def calibration() -> Calibration:
    """As the package carries them."""
    data = json.loads(files("diagnosis.verdict").joinpath("calibration.json").read_text(encoding="utf-8"))
    plain = {name: float(data[name]) for name in Calibration.__dataclass_fields__ if name not in BY_HEADING}
    outside, unseen = (tuple(data[name].items()) for name in BY_HEADING)
    return Calibration(**plain, outside_probability=outside, unseen_probability=unseen)


@dataclass(frozen=True, slots=True)
class Weighed:
    """A hypothesis of one cell and its probability there."""

    score: Score
    probability: float


@dataclass(frozen=True, slots=True)
class Whole:
    """One hypothesis on every cell together."""

    scores: tuple[Score, ...]
    probability: float


def weighed(found: Search) -> tuple[Weighed, ...]:
    """The cell's hypotheses, best first.

    Model: p ~ exp((held-out score - penalty of each effect) / (T spread)); T larger where the floor is not known. An
           effect also pays a share of all that is gained: no model is right to better than this, but what was read
           off the log is. As many names as were chosen pay no more than those for what they gain on the undisturbed
           machine: that told whether anything is there, and says nothing of which of them it is. What scored more than
           was chosen and failed the margin counts by the margin at most: a gain in one motion only is luck.
    """
    numbers = calibration()
    T = numbers.temperature if found.cell.floor_known else numbers.temperature_without_floor
    gained = max(one.total for one in found.scored) - found.none.total
    share = max(found.cell.form_share * gained / found.spread, found.cell.least_nats)
    scored = [one for one in _by_one_law(found) if one is found.chosen or _moves(one)]
    logs = np.array(
        [
            min(one.total, found.chosen.total + MARGIN_NATS * found.spread) / found.spread
            - _price(found.cell, one)
            - _paid(found, one)
            - share * _fitted(one)
            - found.cell.least_nats * (_count(one) - _fitted(one))
            for one in scored
        ]
    )
    logs /= T
    p = np.exp(logs - logs.max())
    p /= p.sum()
    order = np.argsort(-p, kind="stable")
    return tuple(Weighed(scored[k], float(p[k])) for k in order)


def _by_one_law(found: Search) -> list[Score]:
    """Of hypotheses that name the same on the same joints of a driven stage, the chosen or the best one: by which law a
    dead band takes from the flow is no other cause.
    """
    if found.cell.stage not in DRIVEN_STAGES:
        return list(found.scored)
    best: dict[frozenset[Key], Score] = {}
    for one in found.scored:
        keys = frozenset(effect.key for effect in one.fit.hypothesis)
        if keys not in best or one is found.chosen or (best[keys] is not found.chosen and one.total > best[keys].total):
            best[keys] = one
    return list(best.values())


def _moves(one: Score) -> bool:
    """Whether each of its effects does anything: one that is fitted as nothing is no hypothesis of its own."""
    for effect, sizes in one.fit.by_effect:
        same = [slot.parameter == effect.slots[0].parameter for slot in effect.slots]
        away = [
            abs(x - slot.neutral) / (slot.high - slot.low)
            for slot, x, own in zip(effect.slots, sizes, same, strict=True)
            if own
        ]
        if all(share < NOTHING for share in away):
            return False
    return True


def _count(one: Score) -> int:
    return len(one.fit.hypothesis)


def _fitted(one: Score) -> int:
    return sum(not effect.read_off for effect in one.fit.hypothesis)


def _usual_nats(found: Search, one: Score) -> float:
    return usual_nats(found.cell, one.fit) / found.spread


def _paid(found: Search, one: Score) -> float:
    """What a hypothesis pays for its names' usual gains; as many names as were chosen pay no more than those."""
    usual = _usual_nats(found, one)
    return min(usual, _usual_nats(found, found.chosen)) if _count(one) == _count(found.chosen) else usual


def _price(cell: Cell, one: Score) -> float:
    """Nats that a hypothesis pays for its effects and their numbers."""
    numbers = calibration()
    foreign = sum(
        numbers.foreign_stage_penalty_nats + _unheard_nats(effect, theta)
        for effect, theta in one.fit.by_effect
        if _foreign(cell, effect.stage)
    )
    return numbers.penalty_nats_per_effect * _count(one) + chosen_nats(one.fit) + foreign


def _unheard_nats(effect: Candidate, theta: Array) -> float:
    """What a size (slots,) beyond an effect's prior costs its name [nats].

    Why of other stages only: a gain of nine parts in a hundred is a valve; an encoder that reads nine in a hundred too
    little would have been seen by eye, and where nothing behind it was measured nothing else speaks of it.
    """
    size = effect.slots[0]
    if not size.spec.prior.kind.endswith("normal"):
        return 0.0
    usual = size.scale * size.spec.prior.scale
    return min(0.5 * float(theta[0] / usual) ** 2, UNHEARD_NATS)


def _foreign(cell: Cell, stage: str) -> bool:
    """Whether an effect's stage is not the cell's own. Points see joints and links together; a joined cell is at home
    in every stage behind the encoders.
    """
    return not cell.parts and stage not in SEEN_TOGETHER.get(cell.stage, (cell.stage,))


def settled(found: Search) -> Score:
    """The chosen hypothesis, or an equivalent one whose effects are likelier before any data.

    Why: an encoder's scale and a flow gain are one direction in the data, and so are a joint's zero and the next axis'
    tilt; the report names the class, and first what belongs to the cell's own stage, or is set by hand.
    """
    own = _of_own_stage(found)
    rivals = [one for one in _alike(found, own, EQUAL_NATS * found.spread) if _by_hand(one) > _by_hand(own)]
    return max(rivals, key=lambda one: (_by_hand(one), one.total), default=own)


def _of_own_stage(found: Search) -> Score:
    """The chosen hypothesis, or an equivalent one that pays less for stages which are not the cell's own."""
    chosen, cell = found.chosen, found.cell
    if not any(_foreign(cell, effect.stage) for effect in chosen.fit.hypothesis):
        return chosen
    price = _price(cell, chosen) + _usual_nats(found, chosen)
    rivals = [
        one
        for one in _alike(found, chosen, MARGIN_NATS + 0.01 * (chosen.total - found.none.total))
        if _price(cell, one) + _usual_nats(found, one) < price
    ]
    return max(rivals, key=lambda one: one.total, default=chosen)


def _alike(found: Search, chosen: Score, allowed: float) -> list[Score]:
    """Hypotheses of as many names that change the same, and score no less than this [nats, not divided]."""
    none = found.none.fit.residual
    return [
        one
        for one in found.scored
        if _count(one) == _count(chosen)
        and one is not chosen
        and _moves(one)
        and chosen.total - one.total < allowed
        and _cosine(one.fit.residual - none, chosen.fit.residual - none) > SAME_DIRECTION
    ]


def _by_hand(one: Score) -> int:
    return sum(effect.name in SET_BY_HAND for effect in one.fit.hypothesis)


def combined(per_cell: list[tuple[Weighed, ...]]) -> tuple[Whole, ...]:
    """The most probable combinations over all cells, best first: the cells are independent."""
    kept = [tuple(one for one in cell if one.probability >= SHARE_MIN) or cell[:1] for cell in per_cell]
    number = count()
    first: tuple[int, ...] = (0,) * len(kept)
    queue: list[tuple[float, int, tuple[int, ...]]] = [(-_probability(kept, first), next(number), first)]
    seen: set[tuple[int, ...]] = {first}
    out: list[Whole] = []
    while queue and len(out) < COMBINATIONS_MAX:
        negative, _, at = heapq.heappop(queue)
        out.append(Whole(tuple(cell[k].score for cell, k in zip(kept, at, strict=True)), -negative))
        for i in range(len(kept)):
            following = (*at[:i], at[i] + 1, *at[i + 1 :])
            if following[i] < len(kept[i]) and following not in seen:
                seen.add(following)
                heapq.heappush(queue, (-_probability(kept, following), next(number), following))
    return tuple(out)


def _probability(kept: list[tuple[Weighed, ...]], at: tuple[int, ...]) -> float:
    return float(np.prod([cell[k].probability for cell, k in zip(kept, at, strict=True)])) if kept else 1.0


def same_here(found: Search, chosen: Score) -> tuple[tuple[Key, ...], ...]:
    """Classes of effects that this recording cannot tell apart from each chosen effect.

    Model: at the size that it was named with, T = least |W (f_i - f_j)|^2 over j's size (one linear step) below 9. What
           points the same way (|cos| above 0.95) is told apart all the same where it is large: the data decide, not the
           angle.
    Why at that size: as the only name, beside five others, it may fit best at next to nothing, which is like all else.
    """
    classes: list[tuple[Key, ...]] = []
    none = found.none.fit.residual
    for effect, theta in chosen.fit.by_effect:
        own = evaluated(found.cell, (effect,), theta[None])[0] - none
        rivals = [effect.key, *_exchanged(found, chosen, effect.key)]
        for scan in found.scans:
            key = scan.candidate.key
            other = _column(found, key)
            if key in rivals or other is None:
                continue
            cosine = _cosine(own, other)
            left = float(own @ own) * (1.0 - cosine**2)
            if left / found.spread < SEPARATED_NATS:
                rivals.append(key)
        if len(rivals) > 1:
            classes.append(tuple(rivals))
    return tuple(classes)


def _exchanged(found: Search, chosen: Score, key: Key) -> list[Key]:
    """Effects that leave the same as this one beside the other names, both fitted: |W (f_i - f_j)|^2 below 9.

    Why besides one linear step: a zero that is off by two degrees and the next axis' tilt are not the same to first
    order in either.
    """
    rest = {effect.key for effect in chosen.fit.hypothesis if effect.key != key}
    out = []
    for one in found.scored:
        keys = {effect.key for effect in one.fit.hypothesis}
        other = keys - rest
        if len(keys) != len(rest) + 1 or not rest < keys or key in other:
            continue
        apart = one.fit.residual - chosen.fit.residual
        if float(apart @ apart) / found.spread < SEPARATED_NATS:
            out += list(other)
    return list(dict.fromkeys(out))


def _column(found: Search, key: Key) -> Array | None:
    """How an effect changes the residual: at its fitted size, else where its scan was best."""
    none = found.none.fit.residual
    for one in found.scored:
        if len(one.fit.hypothesis) == 1 and one.fit.hypothesis[0].key == key:
            return one.fit.residual - none
    for scan in found.scans:
        if scan.candidate.key == key:
            theta = scan.thetas[[scan.best]]
            change = evaluated(found.cell, (scan.candidate,), theta)[0] - none
            return change if float(change @ change) > 0.0 else None
    return None


def _cosine(a: Array, b: Array) -> float:
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0
