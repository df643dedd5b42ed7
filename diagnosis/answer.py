"""The error budget as JSON (format version 2). What each field means: docs/diagnosis-answer.md."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from diagnosis.budget import Budget
from diagnosis.cells.points import left_out
from diagnosis.experiments.choice import Key, Pair, experiment_for
from diagnosis.experiments.prediction import hypothesis_at_fit
from diagnosis.hypotheses import hypotheses_of, sized_effect_of_line
from diagnosis.localise import Place, merged_stages, totals_of
from diagnosis.search.candidates import Candidate
from diagnosis.search.fit import Fit
from diagnosis.shrink import closed_share, gap_closed_of_parts, rms_of
from diagnosis.sliding import in_metres
from diagnosis.verdict import EffectLine
from diagnosis.whole_model.evidence import DISTINCT_SQUARED_DISTANCE_MIN, smallest_detectable
from diagnosis.whole_model.linear import EffectTerm
from diagnosis.whole_model.probability import EVIDENCE_FEATURE_NAMES, evidence_features
from diagnosis.whole_model.solve import Fitted, WholeFit, fit_of
from machine.effects.registry import effect_of
from machine.effects.spec import Direction
from machine.rotations import Array

FORMAT_VERSION = 2
AMBIGUITY_LIMIT_NATS = (
    0.5 * DISTINCT_SQUARED_DISTANCE_MIN
)  # two sets closer than this are a doubt that an experiment may settle
MM_DECIMALS = 4


def answer_json(found: Budget) -> dict[str, Any]:
    """Everything the contract asks for."""
    hypotheses = _hypotheses_json(found)
    result: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "verdict": found.verdict,
        "why": found.verdict_reason,
        "budget": _budget_json(found),
        "stages": [
            {
                "stage": line.stage,
                "joint": line.joint,
                "verdict": line.verdict,
                "before_mm": _rounded_mm(line.before_mm),
                "after_mm": _rounded_mm(line.after_mm),
                "would_measure": line.verdict_reason if line.verdict == "not_measured" else "",
            }
            for line in found.stage_verdicts
        ],
        "hypotheses": hypotheses,
        "outside_probability": 1.0 if found.verdict == "outside" else 0.0,
        "indistinguishable": [
            [_effect_key(line.evidence.effect_term), *map(_effect_key, members)]
            for line in found.effect_lines
            for members in line.evidence.equivalent_effect_sets
        ],
        "credible_set_90": [
            {"effects": _effect_keys(row["effects"]), "probability": row["probability"]} for row in hypotheses
        ],
        "localisation": _localisation_json(found.localisation.gap_places),
        "merged_stages": [{"stages": list(stages), "missing": why} for stages, why in merged_stages(found.recording)],
        "shrink": _shrink_json(found),
        "unexplained": [
            {
                "test": "miss left at the tool [mm]",
                "stage": line.stage,
                "joint": line.joint,
                "size": _rounded_mm(line.after_mm),
                "p_value": None,
                "lead": line.verdict_reason,
            }
            for line in found.stage_verdicts
            if line.verdict in ("partly", "unexplained")
        ],
        "detection_limits": list(_detection_limits(found)),
        "missing": _missing_signals(found),
        "findings": [{"code": f.code, "severity": f.severity, "text": str(f)} for f in found.recording.findings],
        "searched": [_search_summary(fit) for fit in found.part_fits],
        "next_experiment": experiment_for(found.recording, _open_pairs(found), found.verdict in ("none", "effects")),
    }
    nominal = found.recording.nominal_machine
    result["budget"]["sentence"] = summary_sentence(result["budget"])
    return in_metres(result, nominal.joint_slides) if nominal is not None and any(nominal.joint_slides) else result


def summary_sentence(budget: dict[str, Any]) -> str:
    """What the model misses by, how much of it is explained, what is left."""
    if not budget["columns"]:
        return "Nothing in this recording says what the effects do at the tool."
    sure = [row for row in budget["effects"] if row["status"] == "confirmed" and row["column"] != "sees"]
    out = f"The model misses the tool by {budget['miss_mm']:.3g} mm."
    if sure:
        out += f" With the {len(sure)} confirmed effects it misses by {budget['left_mm']:.3g} mm."
    seen = next((column for column in budget["columns"] if column["column"] == "sees"), None)
    if seen is not None:
        out += f" The camera misplaces what it sees by {seen['before_mm']:.3g} mm"
        out += f", with the confirmed effects by {seen['after_mm']:.3g} mm."
    return out


def _budget_json(found: Budget) -> dict[str, Any]:
    return {
        "miss_mm": _rounded_mm(found.miss_mm),
        "left_mm": _rounded_mm(found.left_mm),
        "columns": [
            {
                "column": column.name,
                "before_mm": _rounded_mm(column.before_mm),
                "after_mm": _rounded_mm(column.after_mm),
                "floor_mm": _rounded_mm(column.floor_mm),
                "measured": column.is_measured,
            }
            for column in found.budget_columns
        ],
        "effects": [_effect_line_json(line, found.machine_file_terms) for line in found.effect_lines],
        "unexplained_mm": [
            {"stage": stage.stage, "joint": stage.joint, "mm": _rounded_mm(stage.after_mm)}
            for stage in found.stage_verdicts
            if stage.verdict in ("partly", "unexplained")
        ],
    }


def _effect_line_json(line: EffectLine, machine: tuple[EffectTerm, ...]) -> dict[str, Any]:
    evidence = line.evidence
    used = next((term for term in machine if term.effect == evidence.effect_term.effect), None)
    return {
        **_effect_table(*sized_effect_of_line(line)),
        "column": line.budget_column,
        "tool_mm": _rounded_mm(line.tool_rms_mm),
        "tool_low_mm": _rounded_mm(line.low_mm),
        "tool_high_mm": _rounded_mm(line.high_mm),
        "squares_mm2": round_numbers(line.squares_mm2),
        "share_frac": round_numbers(line.share_frac),
        "probability": round_numbers(line.probability),
        "status": line.status,
        "used": None if used is None else _machine_file_parameters(used),
        "equals": [[_effect_key(member) for member in members] for members in evidence.equivalent_effect_sets],
        "evidence": {
            "gain_nats": round_numbers(evidence.gain_nats),
            "size_over_sd": round_numbers(evidence.size_z_score),
            "scatter_frac": round_numbers(evidence.size_scatter_frac),
            "left_floors": round_numbers(evidence.residual_mean_square),
            "noise_known": evidence.noise_known,
            "figures": dict(
                zip(EVIDENCE_FEATURE_NAMES, [round_numbers(float(x)) for x in evidence_features(evidence)], strict=True)
            ),
        },
    }


def _machine_file_parameters(term: EffectTerm) -> dict[str, Any]:
    """A machine file's numbers of an effect, fitted without the doubtful ones."""
    table = _effect_table(term.effect, np.stack([term.theta] * 3, axis=1))
    return {
        name: {"value": parameter["value"], "unit": parameter["unit"]}
        for name, parameter in table["parameters"].items()
    }


def _effect_table(candidate: Candidate, numbers: Array) -> dict[str, Any]:
    """An effect with its numbers (slots, 3): value and 90 % limits."""
    effect = effect_of(candidate.name)
    parameters: dict[str, Any] = {}
    vector = len({slot.parameter for slot in candidate.parameter_slots}) < len(candidate.parameter_slots)
    if vector and effect.direction is not None:
        parameters = _size_and_direction(
            candidate.parameter_slots[0].parameter, effect.size.unit, effect.direction, numbers
        )
    else:
        for slot, number in zip(candidate.parameter_slots, numbers, strict=True):
            parameters[slot.parameter] = _value_with_limits(number, slot.spec.unit)
    for slot, value in candidate.fixed_parameters:
        parameters[slot.parameter] = {"value": value, "unit": "1", "low": value, "high": value}
    if candidate.variant_option and effect.quantity_choice is not None:
        parameters[effect.quantity_choice.name] = {
            "value": candidate.variant_option,
            "unit": "",
            "low": None,
            "high": None,
        }
    return {"name": candidate.name, "joint": candidate.joint, "stage": candidate.stage, "parameters": parameters}


def _value_with_limits(number: Array, unit: str) -> dict[str, Any]:
    low, high = _round_outward(float(number[1]), -1), _round_outward(float(number[2]), 1)
    return {"value": round_numbers(float(number[0])), "unit": unit, "low": low, "high": high}


def _size_and_direction(name: str, unit: str, direction: Direction, numbers: Array) -> dict[str, Any]:
    vector = np.zeros(len(direction.default_vector))
    vector[: len(numbers)] = numbers[:, 0]
    half = float(np.max(0.5 * (numbers[:, 2] - numbers[:, 1])))
    size = float(np.linalg.norm(vector))
    along = (vector / size).tolist() if size > 0.0 else vector.tolist()
    low, high = _round_outward(max(0.0, size - half), -1), _round_outward(size + half, 1)
    return {
        name: {"value": round_numbers(size), "unit": unit, "low": low, "high": high},
        direction.name: {"value": [round_numbers(x) for x in along], "unit": "1", "low": None, "high": None},
    }


def _hypotheses_json(found: Budget) -> list[dict[str, Any]]:
    """What is more likely there than not, then what the recording leaves open, until the sets hold 90 %."""
    if not found.part_fits:
        return []
    return [
        {
            "effects": [_effect_table(*effect) for effect in held.effects],
            "probability": round_numbers(held.probability),
        }
        for held in hypotheses_of(found.effect_lines, found.part_fits)
    ]


def _effect_key(term: EffectTerm) -> dict[str, Any]:
    return {"name": term.effect.name, "joint": term.effect.joint}


def _effect_keys(effects: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{"name": effect["name"], "joint": effect["joint"]} for effect in effects]


def _rounded_mm(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), MM_DECIMALS)


DYNAMIC_STAGE_METRIC = "RMS of 20 Hz increments on held-out motions"
METRIC_BY_STAGE_AND_UNIT = {  # by stage and unit
    ("structure", "m"): "RMS of measured points on held-out poses or pieces of a motion",
    ("camera", "px"): "RMS of marker corners on held-out frames",
    ("camera", "m"): "RMS of path lengths of a second on held-out pieces of a motion",
}


def _shrink_json(found: Budget) -> dict[str, Any]:
    """How far the gap shrinks on motions that nothing was fitted to: each part, and overall the parts with effects."""
    closing = zip(found.held_out, found.gap_closures, strict=True)
    parts = [(prediction, *part) for prediction, own in closing for part in own]
    stages = [
        {
            "stage": row.stage,
            "joint": row.joint,
            "measurement": row.measurement,
            "metric": METRIC_BY_STAGE_AND_UNIT.get((row.stage, row.unit), DYNAMIC_STAGE_METRIC),
            "unit": row.unit,
            **_gap_closed_json(
                (row.rms_without_effects, row.rms_with_effects, row.noise_floor), row.closed_frac_with_limits
            ),
        }
        for _, row, _ in parts
    ]
    sums = [sums for gap, _, sums in parts if gap.fit.k] or [sums for _, _, sums in parts]
    if not sums:
        return {"overall": {}, "stages": stages}
    whole = gap_closed_of_parts(sums)
    metric = {"metric": "RMS of held-out residuals where a gap was found", "unit": "noise floors"}
    return {"overall": {**metric, **_gap_closed_json(rms_of(whole), closed_share(whole))}, "stages": stages}


def _gap_closed_json(rms: Sequence[float], closed: Sequence[float | None]) -> dict[str, Any]:
    names = ("before", "after", "floor", "closed_frac", "low", "high")
    return dict(zip(names, map(round_numbers, (*rms, *closed)), strict=True))


def _localisation_json(places: tuple[Place, ...]) -> list[dict[str, Any]]:
    """First each stage as a whole, then its joints or axes, which share what it has, and their regimes."""
    return [
        {
            "stage": place.stage,
            "joint": place.joint,
            "axis": place.axis,
            "regime": place.motion_regime,
            "gap": round_numbers(place.model_gap),
            "floor": round_numbers(place.noise_floor),
            "unit": place.unit,
            "gap_tcp_mm": round_numbers(place.tcp_mm),
            "share_frac": round_numbers(place.share_frac),
        }
        for place in (*totals_of(places), *places)
    ]


def _detection_limits(found: Budget) -> Iterator[dict[str, Any]]:
    for fit in found.part_fits:
        for k, size in smallest_detectable(fit).items():
            slot = fit.best_fit.current_terms[k].effect.parameter_slots[0]
            yield {
                **_effect_key(fit.best_fit.current_terms[k]),
                "parameter": slot.parameter,
                "size": round_numbers(float(size)),
                "unit": slot.spec.unit,
            }


def _missing_signals(found: Budget) -> list[dict[str, str]]:
    whole, nominal = found.recording, found.recording.nominal_machine
    out = [
        {"signal": stage.stage, "costs": f"{stage.stage} is not measured: {stage.verdict_reason}"}
        for stage in found.stage_verdicts
        if stage.verdict == "not_measured"
    ]
    if whole.log_unused:
        text = "no segment of run.toml lies in the PLC's log: nothing of it was replayed; correct the segments' times"
        out.append({"signal": "PLC's log", "costs": text})
    out += [{"signal": why.split(":")[0], "costs": why} for _, why in found.localisation.merged_stage_reasons]
    out += [{"signal": part, "costs": text} for part, text in whole.missing_parts]
    if nominal is not None and whole.tables is not None:
        out += [{"signal": "points", "costs": text} for text in left_out(nominal, whole.tables)]
    guessed = [fit.cell.label for fit in found.part_fits if not fit.cell.floor_known]
    if guessed:
        text = f"no usable repeats of {', '.join(guessed)}: the noise was estimated; repeat one command four times"
        out.append({"signal": "repeats", "costs": text})
    return out


def _search_summary(fit: WholeFit) -> dict[str, Any]:
    return {
        "stage": fit.cell.stage,
        "joint": fit.cell.joint,
        "rows": fit.cell.rows.row_count,
        "rivals": sum(rival is not None for rival in fit.rival_fit_by_term.values()),
        "candidates": len(fit.best_fit.current_terms),
        "spread": round_numbers(float(np.mean(fit.best_fit.linear_model.residual**2))),
        "trust": round_numbers(float(np.mean(fit.correlation_weight))),
        "floor_known": fit.cell.floor_known,
        "settled": fit.converged,
    }


def _open_pairs(found: Budget) -> list[list[Pair]]:
    """Doubts by part: the best set against each rival that the recording does not exclude, heaviest first."""
    out = []
    for fit in found.part_fits:
        mine = hypothesis_at_fit(
            fit_of(fit.best_fit.current_terms, fit.best_fit.linear_model), _variance_inflation(fit)
        )
        pairs = []
        for number, rival in _open_rivals(fit):
            other = hypothesis_at_fit(fit_of(rival.current_terms, rival.linear_model), _variance_inflation(fit))
            weight = next(
                (
                    line.tool_rms_mm
                    for line in found.effect_lines
                    if line.evidence.effect_term is fit.best_fit.current_terms[number]
                ),
                0.0,
            )
            names = _first_apart(mine.fit, other.fit), _first_apart(other.fit, mine.fit)
            pairs.append(Pair(fit.cell, _variance_inflation(fit), mine, other, weight + 1e-6, names))
        if pairs:
            out.append(sorted(pairs, key=lambda pair: -pair.importance_weight)[:3])
    return sorted(out, key=lambda pairs: -pairs[0].importance_weight)


def _first_apart(first: Fit, other: Fit) -> Key | None:
    """The first effect that only `first` has."""
    return next(
        (
            effect.effect_and_joint
            for effect in first.hypothesis
            if effect.effect_and_joint not in {x.effect_and_joint for x in other.hypothesis}
        ),
        None,
    )


def _variance_inflation(fit: WholeFit) -> float:
    return 1.0 / float(np.mean(fit.correlation_weight))


def _open_rivals(fit: WholeFit) -> Iterator[tuple[int, Fitted]]:
    for number, rival in fit.rival_fit_by_term.items():
        if rival is not None and fit.best_fit.log_posterior_nats - rival.log_posterior_nats < AMBIGUITY_LIMIT_NATS:
            yield number, rival
    for kept, out in fit.collinear_term_pairs:
        if fit.best_fit.present_terms[kept]:
            yield kept, _fit_with_twin_effect(fit, kept, out)


def _fit_with_twin_effect(fit: WholeFit, kept: int, out: int) -> Fitted:
    """The best set with an effect's twin in its place: their columns differ by a factor."""
    lin = fit.best_fit.linear_model
    mine, other = (lin.J[:, lin.term_first_column[k]] for k in (kept, out))
    ratio = float(mine @ other) / max(float(other @ other), 1e-300)
    terms = list(lin.effect_terms)
    terms[out] = replace(terms[out], theta=ratio * terms[kept].theta, is_present=True)
    terms[kept] = replace(terms[kept], theta=np.zeros_like(terms[kept].theta), is_present=False)
    J: Array = lin.J.copy()
    x = lin.parameter_offsets.copy()
    x[lin.term_first_column[out]], x[lin.term_first_column[kept]] = ratio * x[lin.term_first_column[kept]], 0.0
    moved = replace(lin, effect_terms=tuple(terms), J=J, parameter_offsets=x)
    return replace(fit.best_fit, linear_model=moved)


def round_numbers(value: float | None) -> float | None:
    """Six digits; None for what is not a finite number."""
    return float(f"{value:.6g}") if value is not None and np.isfinite(value) else None


def _round_outward(limit: float, side: int) -> float | None:
    """Six digits, down (side -1) or up (+1): a step that is known to a millionth is not outside its limits by them."""
    near = round_numbers(limit)
    if near is None or (near - limit) * side >= 0.0:
        return near
    digit = 10.0 ** (np.floor(np.log10(abs(limit))) - 5.0)
    return round_numbers(near + side * digit)
