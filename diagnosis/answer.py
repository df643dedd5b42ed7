"""The answer as JSON: its names are the contract's and never change. What each field means: docs/diagnosis-answer.md.

One meaning has changed: `share_frac` was of the gaps carried to the tcp, and is of what was found wrong where anything
was (decision 30). Those gaps are `gap_tcp_mm`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnosis.cells.points import left_out
from diagnosis.diagnose import Diagnosis
from diagnosis.experiments.choice import next_experiment
from diagnosis.localise import Place, totals_of
from diagnosis.rivals import rivals
from diagnosis.search.candidates import Candidate
from diagnosis.search.limits import Interval
from diagnosis.search.score import Score
from diagnosis.sliding import in_metres
from diagnosis.verdict.cell_answer import CellAnswer
from diagnosis.verdict.certain import share_of_first
from diagnosis.verdict.equals import probability_with_equals
from diagnosis.verdict.shrink import Shrink, Squares, closing, together
from diagnosis.verdict.unseen import counted_as, one_more, outside_share, unseen_share
from diagnosis.verdict.unweighed import unweighed
from diagnosis.verdict.verdict import DOUBTED
from diagnosis.verdict.weigh import Key, Whole
from machine.effects.registry import effect_of
from machine.effects.spec import Direction
from machine.rotations import Array

FORMAT = 1
MASS_90 = 0.9
HYPOTHESES_MAX = 10
METRIC_DRIVEN = "RMS of 20 Hz increments on held-out trajectories"
METRICS = {  # by stage and unit
    ("structure", "m"): "RMS of measured points on held-out poses or pieces of a motion",
    ("camera", "px"): "RMS of marker corners on held-out frames",
    ("camera", "m"): "RMS of path lengths of a second on held-out pieces of a motion",
}


def answer(found: Diagnosis) -> dict[str, Any]:
    """Everything the contract asks for."""
    return {**judgement(found), "shapes": _shapes(found.cells), "next_experiment": next_experiment(found)}


def judgement(found: Diagnosis) -> dict[str, Any]:
    """What the recording says, without what to do next."""
    shares = _shares(found)
    count = min(len(found.hypotheses), HYPOTHESES_MAX)
    hypotheses = [_hypothesis(found, number, shares) for number in range(count)]
    told: dict[str, Any] = {
        "format_version": FORMAT,
        "verdict": found.verdict.word,
        "why": found.verdict.why,
        "hypotheses": hypotheses,
        "outside_probability": shares.outside,
        "unseen_probability": rounded((1.0 - shares.outside) * shares.unseen),
        "indistinguishable": _classes(found),
        "credible_set_90": _credible(found, shares),
        "localisation": localisation_table(found.localisation.places),
        "merged_stages": [{"stages": list(stages), "missing": why} for stages, why in found.localisation.merged],
        "shrink": _shrink(found),
        "unexplained": _unexplained(found.cells),
        "detection_limits": _limits(found.cells),
        "missing": _missing(found),
        "findings": [{"code": f.code, "severity": f.severity, "text": str(f)} for f in found.whole.findings],
        "searched": [_searched(one) for one in found.cells],
        "rivals": rivals(found.cells),
    }
    for number, one in enumerate(hypotheses):
        one["probability_with_equals"] = rounded(probability_with_equals(told, number))
    nominal = found.whole.nominal
    return in_metres(told, nominal.sliding) if nominal is not None and any(nominal.sliding) else told


@dataclass(frozen=True, slots=True)
class _Shares:
    """Probability that a cause outside the catalogue is at work; if it is none, that a further name is too small to be
    seen.
    """

    outside: float
    unseen: float

    @property
    def inside(self) -> float:
        """Probability that the names printed are all that is at work."""
        return (1.0 - self.outside) * (1.0 - self.unseen)


def _shares(found: Diagnosis) -> _Shares:
    heading = counted_as(found.verdict.word, share_of_first(found.cells, found.hypotheses))
    return _Shares(outside_share(heading), unseen_share(heading))


def _hypothesis(found: Diagnosis, number: int, shares: _Shares) -> dict[str, Any]:
    whole = found.hypotheses[number]
    effects = [effect for score in whole.scores for effect in _effects(score, found.numbers.get(id(score), ()))]
    return {"effects": effects, "probability": rounded(whole.probability * shares.inside)}


def probability_of_first(found: Diagnosis) -> float:
    """The probability that the answer states of its first hypothesis; 1 where nothing was searched."""
    return found.hypotheses[0].probability * _shares(found).inside if found.hypotheses else 1.0


def _effects(score: Score, numbers: tuple[Interval, ...]) -> list[dict[str, Any]]:
    out: list[dict[str, Any]] = []
    for one, own in score.fit.slices:
        out.append(effect_table(one, numbers[own] if numbers else _plain(score.fit.theta[own])))
    return out


def effect_table(one: Candidate, numbers: tuple[Interval, ...]) -> dict[str, Any]:
    """An effect with its numbers and their limits."""
    effect = effect_of(one.name)
    parameters: dict[str, Any] = {}
    vector = len({slot.parameter for slot in one.slots}) < len(one.slots)
    if vector and effect.direction is not None:
        parameters = _vector(one.slots[0].parameter, effect.size.unit, effect.direction, numbers)
    else:
        for slot, number in zip(one.slots, numbers, strict=True):
            parameters[slot.parameter] = _number(number, slot.spec.unit)
    for slot, value in one.fixed:
        parameters[slot.parameter] = {"value": value, "unit": "1", "low": value, "high": value}
    if one.option and effect.choice is not None:
        parameters[effect.choice.name] = {"value": one.option, "unit": "", "low": None, "high": None}
    return {"name": one.name, "joint": one.joint, "stage": one.stage, "parameters": parameters}


def _plain(theta: Array) -> tuple[Interval, ...]:
    return tuple(Interval(float(x), float(x), float(x)) for x in theta)


def _number(number: Interval, unit: str) -> dict[str, Any]:
    low, high = _round_outward(number.low, -1), _round_outward(number.high, 1)
    return {"value": rounded(number.value), "unit": unit, "low": low, "high": high}


def _vector(name: str, unit: str, direction: Direction, numbers: tuple[Interval, ...]) -> dict[str, Any]:
    vector = np.zeros(len(direction.default))
    vector[: len(numbers)] = [one.value for one in numbers]
    half = max(0.5 * (one.high - one.low) for one in numbers)
    size = float(np.linalg.norm(vector))
    along = (vector / size).tolist() if size > 0.0 else vector.tolist()
    low, high = _round_outward(max(0.0, size - half), -1), _round_outward(size + half, 1)
    return {
        name: {"value": rounded(size), "unit": unit, "low": low, "high": high},
        direction.name: {"value": [rounded(x) for x in along], "unit": "1", "low": None, "high": None},
    }


def _classes(found: Diagnosis) -> list[list[dict[str, Any]]]:
    """Effects that this recording cannot tell apart, and those that this machine file cannot."""
    classes = [members for one in found.cells for members in one.same]
    classes += unweighed(found.whole.nominal, _keys(found.hypotheses[0]) if found.hypotheses else ())
    return [[{"name": name, "joint": joint} for name, joint in members] for members in classes]


def _credible(found: Diagnosis, shares: _Shares) -> list[dict[str, Any]]:
    """The fewest hypotheses that hold 90 % of what the catalogue can explain: those weighed, and the first one with one
    more name that is too small to be seen.
    """
    unseen = shares.unseen
    first = _keys(found.hypotheses[0]) if found.hypotheses else ()
    weighed = [(_keys(whole), (1.0 - unseen) * whole.probability) for whole in found.hypotheses]
    others = one_more(found.cells, frozenset(first)) if unseen > 0.0 else ()
    further = [((*first, key), unseen * part) for key, part in others]
    masses: dict[frozenset[Key], float] = {}
    for keys, part in (*weighed, *further):
        masses[frozenset(keys)] = masses.get(frozenset(keys), 0.0) + part
    rows = sorted(masses.items(), key=lambda row: -row[1])
    out, mass = [], 0.0
    for keys, probability in rows:
        named = [{"name": name, "joint": joint} for name, joint in sorted(keys, key=str)]
        out.append({"effects": named, "probability": rounded(probability * (1.0 - shares.outside))})
        mass += probability
        if mass >= MASS_90:
            break
    return out


def _keys(whole: Whole) -> tuple[Key, ...]:
    return tuple(one.key for score in whole.scores for one in score.fit.hypothesis)


def localisation_table(places: tuple[Place, ...]) -> list[dict[str, Any]]:
    """First each stage as a whole, then its joints or axes, which share what it has, and their regimes."""
    return [
        {
            "stage": place.stage,
            "joint": place.joint,
            "axis": place.axis,
            "regime": place.regime,
            "gap": rounded(place.gap),
            "floor": rounded(place.floor),
            "unit": place.unit,
            "gap_tcp_mm": rounded(place.tcp_mm),
            "share_frac": rounded(place.share_frac),
        }
        for place in (*totals_of(places), *places)
    ]


def _shrink(found: Diagnosis) -> dict[str, Any]:
    rows = tuple(part for one in found.cells for part in one.shrinks)
    found_in = [one for one in found.cells if one.fired or one.chosen.fit.hypothesis] or found.cells
    return shrink_table(rows, [part for one in found_in for part in one.squares])


def shrink_table(rows: Iterable[Shrink], squares: Sequence[Squares]) -> dict[str, Any]:
    """How far the gap shrinks, part by part; overall by the squares of the parts where something was found."""
    stages = []
    for s in rows:
        stages.append(
            {
                "stage": s.stage,
                "joint": s.joint,
                "measurement": s.measurement,
                "metric": METRICS.get((s.stage, s.unit), METRIC_DRIVEN),
                "unit": s.unit,
                "before": rounded(s.before),
                "after": rounded(s.after),
                "floor": rounded(s.floor),
                "floor_by": s.floor_by,
                "closed_frac": rounded(s.closed_frac),
                "low": rounded(s.low),
                "high": rounded(s.high),
            }
        )
    return {"overall": _overall(squares), "stages": stages}


def _overall(squares: Sequence[Squares]) -> dict[str, Any]:
    """Parts together, each in units of its own floor."""
    if not squares:
        return {}
    before, after, floor, (closed, low, high), floor_by = closing(together(squares))
    return {
        "metric": "RMS of held-out residuals where a gap was found",
        "unit": "noise floors",
        "before": rounded(before),
        "after": rounded(after),
        "floor": rounded(floor),
        "floor_by": floor_by,
        "closed_frac": rounded(closed),
        "low": rounded(low),
        "high": rounded(high),
    }


def _unexplained(cells: tuple[CellAnswer, ...]) -> list[dict[str, Any]]:
    return [
        {
            "test": fired.test,
            "stage": fired.stage,
            "joint": fired.joint,
            "size": rounded(fired.size),
            "p_value": rounded(fired.p_value),
            "lead": fired.lead,
        }
        for one in cells
        for fired in one.fired
    ]


def _shapes(cells: tuple[CellAnswer, ...]) -> list[dict[str, Any]]:
    """What the chosen names leave is a function of; less what the undisturbed machine shows, where a baseline says."""
    return [
        {
            "stage": shape.stage,
            "joint": shape.joint,
            "measurement": shape.measurement,
            "goes_with": shape.goes_with,
            "nats": rounded(shape.nats),
        }
        for one in cells
        for shape in one.shapes
    ]


def _limits(cells: tuple[CellAnswer, ...]) -> list[dict[str, Any]]:
    out = []
    for one in cells:
        for limit in one.limits:
            out.append(
                {
                    "name": limit.name,
                    "joint": limit.joint,
                    "parameter": limit.parameter,
                    "size": rounded(limit.size),
                    "unit": effect_of(limit.name).size.unit,
                }
            )
    return out


def _missing(found: Diagnosis) -> list[dict[str, str]]:
    out = [{"signal": why.split(":")[0], "costs": why} for _, why in found.localisation.merged]
    nominal = found.whole.nominal
    out += [{"signal": part, "costs": text} for part, text in found.whole.lacking]
    guessed = [one.search.cell.label for one in found.cells if not one.search.cell.floor_known]
    if nominal is not None and found.whole.tables is not None:
        out += [{"signal": "points", "costs": text} for text in left_out(nominal, found.whole.tables)]
    if guessed:
        of = "" if len(guessed) == len(found.cells) else f" of {', '.join(guessed)}"
        text = f"no usable repeats{of}: noise floor estimated, probabilities widened"
        out.append({"signal": "repeats", "costs": text})
    known = nominal is not None and bool(nominal.remainders)
    if not known and found.verdict.word in DOUBTED:
        text = "the machine file does not tell what this machine is like undisturbed: fit it by --fit-baseline first"
        out.append({"signal": "baseline", "costs": text})
    if moved := sorted({joint for one in found.cells for joint in one.search.cell.moved_unlike}):
        several = len(moved) > 1
        joints = f"joint{'s' if several else ''} {', '.join(map(str, moved))}"
        unlike = "the undisturbed recordings" if known else f"{'their' if several else 'its'} model's commands ask"
        text = f"{joints} moved unlike {unlike}: what is left there is a lead and refuses nothing"
        out.append({"signal": f"undisturbed motions like these of {joints}", "costs": text})
    if any(one.search.cell.same_kind for one in found.cells):
        text = "one kind of trajectory only: held-out data are of the same kind, which lag and delay can fool"
        out.append({"signal": "other kinds of trajectory", "costs": text})
    return out


def _searched(one: CellAnswer) -> dict[str, Any]:
    cell = one.search.cell
    return {
        "stage": cell.stage,
        "joint": cell.joint,
        "rows": cell.rows.count,
        "hypotheses": len(one.search.scored),
        "candidates": len(one.search.scans),
        "spread": rounded(one.search.spread),
        "evidence_nats": rounded(one.chosen.evidence - one.search.none.evidence),
        "held_out_nats": rounded(one.chosen.total - one.search.none.total),
        "floor_known": cell.floor_known,
    }


def rounded(value: float | None) -> float | None:
    """Six digits; None for what is not a finite number."""
    return float(f"{value:.6g}") if value is not None and np.isfinite(value) else None


def _round_outward(limit: float, side: int) -> float | None:
    """Six digits, down (side -1) or up (+1): a step that is known to a millionth is not outside its limits by them."""
    near = rounded(limit)
    if near is None or (near - limit) * side >= 0.0:
        return near
    digit = 10.0 ** (np.floor(np.log10(abs(limit))) - 5.0)
    return rounded(near + side * digit)
