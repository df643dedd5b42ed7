"""The error budget as JSON (format version 2). What each field means: docs/diagnosis-answer.md."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from diagnosis.answer import effect_table, localisation_table, rounded, shrink_table
from diagnosis.budget import Budget, Line
from diagnosis.cells.points import left_out
from diagnosis.experiments.choice import experiment_for
from diagnosis.experiments.live import Pair, differing
from diagnosis.experiments.prediction import held
from diagnosis.localise import merged_stages
from diagnosis.search.limits import Interval
from diagnosis.sliding import in_metres
from diagnosis.verdict.shrink import Shrink, Squares, shrunk, squares_of_part
from diagnosis.whole_model.evidence import EQUAL_T, detectable
from diagnosis.whole_model.linear import Term
from diagnosis.whole_model.probability import FEATURES, features
from diagnosis.whole_model.solve import Fitted, WholeFit, fit_of
from machine.rotations import Array

FORMAT = 2
OPEN_NATS = 0.5 * EQUAL_T  # two sets closer than this are a doubt that an experiment may settle
DIGITS = 4


def budget_answer(found: Budget) -> dict[str, Any]:
    """Everything the contract asks for."""
    hypotheses = _hypotheses(found)
    rows, squares = _shrinks(found)
    result: dict[str, Any] = {
        "format_version": FORMAT,
        "verdict": found.verdict,
        "why": found.why,
        "budget": _budget(found),
        "stages": [
            {
                "stage": one.stage,
                "joint": one.joint,
                "verdict": one.verdict,
                "before_mm": _mm(one.before_mm),
                "after_mm": _mm(one.after_mm),
                "would_measure": one.why if one.verdict == "not_measured" else "",
            }
            for one in found.stages
        ],
        "hypotheses": hypotheses,
        "outside_probability": 1.0 if found.verdict == "outside" else 0.0,
        "unseen_probability": 0.0,
        "indistinguishable": [
            [_key(line.evidence.term), *(_key(one) for one in members)]
            for line in found.lines
            for members in line.evidence.equals
        ],
        "credible_set_90": [
            {"effects": _keys(one["effects"]), "probability": one["probability"]} for one in hypotheses
        ],
        "localisation": localisation_table(found.before.places),
        "merged_stages": [{"stages": list(stages), "missing": why} for stages, why in merged_stages(found.whole)],
        "shrink": shrink_table(rows, squares),
        "unexplained": [
            {
                "test": "miss left at the tool [mm]",
                "stage": one.stage,
                "joint": one.joint,
                "size": _mm(one.after_mm),
                "p_value": None,
                "lead": one.why,
            }
            for one in found.stages
            if one.verdict in ("partly", "unexplained")
        ],
        "detection_limits": list(_detection_limits(found)),
        "missing": _missing(found),
        "findings": [{"code": f.code, "severity": f.severity, "text": str(f)} for f in found.whole.findings],
        "searched": [_searched(fit) for fit in found.fits],
        "rivals": {"best_held_out": [], "fit_everything": []},
        "shapes": [],
        "next_experiment": experiment_for(found.whole, _open_pairs(found), found.verdict in ("none", "effects")),
    }
    nominal = found.whole.nominal
    result["budget"]["sentence"] = sentence(result["budget"])
    return in_metres(result, nominal.sliding) if nominal is not None and any(nominal.sliding) else result


def sentence(budget: dict[str, Any]) -> str:
    """What the model misses by, how much of it is explained, what is left."""
    if not budget["columns"]:
        return "Nothing in this recording says what the effects do at the tool."
    sure = [one for one in budget["effects"] if one["status"] == "confirmed" and one["column"] != "sees"]
    out = f"The model misses the tool by {budget['miss_mm']:.3g} mm."
    if sure:
        out += f" With the {len(sure)} confirmed effects it misses by {budget['left_mm']:.3g} mm."
    seen = next((one for one in budget["columns"] if one["column"] == "sees"), None)
    if seen is not None:
        out += f" The camera misplaces what it sees by {seen['before_mm']:.3g} mm"
        out += f", with the confirmed effects by {seen['after_mm']:.3g} mm."
    return out


def _budget(found: Budget) -> dict[str, Any]:
    return {
        "miss_mm": _mm(found.miss_mm),
        "left_mm": _mm(found.left_mm),
        "columns": [
            {
                "column": one.name,
                "before_mm": _mm(one.before_mm),
                "after_mm": _mm(one.after_mm),
                "floor_mm": _mm(one.floor_mm),
                "measured": one.measured,
            }
            for one in found.columns
        ],
        "effects": [_line(line) for line in found.lines],
        "unexplained_mm": [
            {"stage": one.stage, "joint": one.joint, "mm": _mm(one.after_mm)}
            for one in found.stages
            if one.verdict in ("partly", "unexplained")
        ],
    }


def _line(line: Line) -> dict[str, Any]:
    evidence = line.evidence
    return {
        **_effect(line),
        "column": line.column,
        "tool_mm": _mm(line.mm),
        "tool_low_mm": _mm(line.low_mm),
        "tool_high_mm": _mm(line.high_mm),
        "squares_mm2": rounded(line.squares_mm2),
        "share_frac": rounded(line.share_frac),
        "probability": rounded(line.probability),
        "status": line.status,
        "equals": [[_key(one) for one in members] for members in evidence.equals],
        "evidence": {
            "gain_nats": rounded(evidence.gain_nats),
            "size_over_sd": rounded(evidence.z),
            "scatter_frac": rounded(evidence.scatter),
            "left_floors": rounded(evidence.left),
            "noise_known": evidence.noise_known,
            "figures": dict(zip(FEATURES, [rounded(float(x)) for x in features(evidence)], strict=True)),
        },
    }


def _effect(line: Line) -> dict[str, Any]:
    low, high = line.evidence.limits
    numbers = tuple(
        Interval(float(value), float(a), float(b))
        for value, a, b in zip(line.evidence.term.theta, low, high, strict=True)
    )
    return effect_table(line.evidence.term.effect, numbers)


def _hypotheses(found: Budget) -> list[dict[str, Any]]:
    """All effects that are more likely there than not, as one hypothesis: they do not exclude each other."""
    if not found.fits:
        return []
    likely = [line for line in found.lines if line.status != "doubtful"]
    together = float(np.prod([line.probability for line in likely]))
    return [
        {
            "effects": [_effect(line) for line in likely],
            "probability": rounded(together),
            "probability_with_equals": rounded(together),
        }
    ]


def _key(term: Term) -> dict[str, Any]:
    return {"name": term.effect.name, "joint": term.effect.joint}


def _keys(effects: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{"name": one["name"], "joint": one["joint"]} for one in effects]


def _mm(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), DIGITS)


def _shrinks(found: Budget) -> tuple[list[Shrink], list[Squares]]:
    """Each part's residual without effects, and with them where they were refitted without that kind of motion."""
    rows, squares = [], []
    for one in found.compared:
        before, after = one.none.held_out, one.chosen.held_out
        of_rows = np.stack([before**2, after**2, np.zeros(len(before))], axis=1)
        for part, values in one.cell.by_part(of_rows):
            sums = squares_of_part(part, values, one.chosen.fit.k)
            rows.append(shrunk(part, sums))
            if one.chosen.fit.k:
                squares.append(sums)
    return rows, squares


def _detection_limits(found: Budget) -> Iterator[dict[str, Any]]:
    for fit in found.fits:
        for k, size in detectable(fit).items():
            slot = fit.best.terms[k].effect.slots[0]
            yield {
                **_key(fit.best.terms[k]),
                "parameter": slot.parameter,
                "size": rounded(float(size)),
                "unit": slot.spec.unit,
            }


def _missing(found: Budget) -> list[dict[str, str]]:
    whole, nominal = found.whole, found.whole.nominal
    out = [
        {"signal": one.stage, "costs": f"{one.stage} is not measured: {one.why}"}
        for one in found.stages
        if one.verdict == "not_measured"
    ]
    out += [{"signal": part, "costs": text} for part, text in whole.lacking]
    if nominal is not None and whole.tables is not None:
        out += [{"signal": "points", "costs": text} for text in left_out(nominal, whole.tables)]
    guessed = [fit.cell.label for fit in found.fits if not fit.cell.floor_known]
    if guessed:
        text = f"no usable repeats of {', '.join(guessed)}: the noise was estimated; repeat one command four times"
        out.append({"signal": "repeats", "costs": text})
    return out


def _searched(fit: WholeFit) -> dict[str, Any]:
    return {
        "stage": fit.cell.stage,
        "joint": fit.cell.joint,
        "rows": fit.cell.rows.count,
        "hypotheses": len(fit.posterior.probability),
        "candidates": len(fit.best.terms),
        "spread": rounded(float(np.mean(fit.best.lin.residual**2))),
        "trust": rounded(float(np.mean(fit.trust))),
        "floor_known": fit.cell.floor_known,
        "settled": fit.settled,
    }


def _open_pairs(found: Budget) -> list[list[Pair]]:
    """Doubts by part: the best set against each rival that the recording does not exclude, heaviest first."""
    out = []
    for fit in found.fits:
        mine = held(fit_of(fit.best.terms, fit.best.lin), _spread(fit))
        pairs = []
        for number, rival in _rivals(fit):
            other = held(fit_of(rival.terms, rival.lin), _spread(fit))
            weight = next((line.mm for line in found.lines if line.evidence.term is fit.best.terms[number]), 0.0)
            pairs.append(Pair(fit.cell, _spread(fit), mine, other, weight + 1e-6, differing(mine.fit, other.fit)))
        if pairs:
            out.append(sorted(pairs, key=lambda pair: -pair.weight)[:3])
    return sorted(out, key=lambda pairs: -pairs[0].weight)


def _spread(fit: WholeFit) -> float:
    return 1.0 / float(np.mean(fit.trust))


def _rivals(fit: WholeFit) -> Iterator[tuple[int, Fitted]]:
    for number, rival in fit.rivals.items():
        if rival is not None and fit.best.score - rival.score < OPEN_NATS:
            yield number, rival
    for kept, out in fit.twins:
        if fit.best.present[kept]:
            yield kept, _swapped(fit, kept, out)


def _swapped(fit: WholeFit, kept: int, out: int) -> Fitted:
    """The best set with an effect's twin in its place: their columns differ by a factor."""
    lin = fit.best.lin
    mine, other = (lin.J[:, lin.first[k]] for k in (kept, out))
    ratio = float(mine @ other) / max(float(other @ other), 1e-300)
    terms = list(lin.terms)
    terms[out] = replace(terms[out], theta=ratio * terms[kept].theta, present=True)
    terms[kept] = replace(terms[kept], theta=np.zeros_like(terms[kept].theta), present=False)
    J: Array = lin.J.copy()
    x = lin.x.copy()
    x[lin.first[out]], x[lin.first[kept]] = ratio * x[lin.first[kept]], 0.0
    moved = replace(lin, terms=tuple(terms), J=J, x=x)
    return replace(fit.best, lin=moved)
