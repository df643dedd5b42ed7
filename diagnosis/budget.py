"""The error budget: what each effect costs in millimetres at the tool, how sure it is, and what is left unexplained."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.link_angles import without_encoders
from diagnosis.behind.point_residual import PointResidual
from diagnosis.cells.behind import measurement_of
from diagnosis.localise import Localisation, beyond_noise, localise
from diagnosis.reading.read import Read
from diagnosis.replay.repeats import align_repeats
from diagnosis.replay.stretches import repeat_groups
from diagnosis.search.cell import Cell
from diagnosis.search.fit import entries_of as entries_of_fit
from diagnosis.search.work import Progress, WorkProgress, no_progress
from diagnosis.shrink import excess_squares, gaps_closed
from diagnosis.verdict import (
    BudgetColumn,
    Closing,
    EffectLine,
    StageLine,
    Verdict,
    has_baseline,
    stages_of,
    together_mm,
    usual_level,
    verdict_of,
)
from diagnosis.whole_model.evidence import NORMAL_QUANTILE_95, Evidence, evidence_of
from diagnosis.whole_model.held_out import HeldOut, held_out
from diagnosis.whole_model.linear import EffectTerm, pack_terms
from diagnosis.whole_model.parts import fit_machine
from diagnosis.whole_model.probability import CONFIRMED_PROBABILITY, LIKELY_PROBABILITY, probability
from diagnosis.whole_model.solve import WholeFit, fit_of, refit_reduced, refit_terms
from diagnosis.whole_model.tool_error import ToolError, tool_errors
from machine.effects.entries import EffectEntry
from machine.effects.layout import neutral_sets
from machine.effects.structure import tcp_poses
from machine.rotations import Array

MM = 1e3


@dataclass(frozen=True, slots=True)
class Budget:
    """The whole answer. `machine_file_terms`: the effects that are more likely there than not, fitted as if there were
    no other. `gap_closures`: by part of `held_out`, how far its gap closes on motions that were left out.
    """

    recording: Read
    part_fits: tuple[WholeFit, ...]
    effect_lines: tuple[EffectLine, ...]
    machine_file_terms: tuple[EffectTerm, ...]
    budget_columns: tuple[BudgetColumn, ...]
    stage_verdicts: tuple[StageLine, ...]
    localisation: Localisation
    held_out: tuple[HeldOut, ...]
    gap_closures: Closing
    verdict: Verdict
    verdict_reason: str

    @property
    def miss_mm(self) -> float:
        """How far the nominal model misses the tool: where it stands and how it gets there, together."""
        return together_mm(column.before_mm for column in self.budget_columns if column.name != "sees")

    @property
    def left_mm(self) -> float:
        """The same with the confirmed effects added."""
        return together_mm(column.after_mm for column in self.budget_columns if column.name != "sees")

    @property
    def confirmed_effects(self) -> tuple[EffectLine, ...]:
        """Effects that are confirmed."""
        return tuple(line for line in self.effect_lines if line.status == "confirmed")

    def effect_entries(self) -> tuple[EffectEntry, ...]:
        """The effects of a machine file that predicts as well as this recording allows.

        Why not the confirmed ones alone: the model of all effects with a probability of at least a half predicts best.
        Source: median probability model, Barbieri, Berger 2004.
        """
        return entries_of(self.machine_file_terms)


def entries_of(terms: Sequence[EffectTerm]) -> tuple[EffectEntry, ...]:
    """Terms as entries of a machine file."""
    return tuple(entries_of_fit(fit_of(terms)))


def budget_of(whole: Read, progress: Progress = no_progress, left_out: tuple[str, ...] = ()) -> Budget:
    """The budget of a recording that is usable. `left_out`: effects taken out of the library, to test refusals."""
    work = WorkProgress(progress)
    fits = fit_machine(whole, work, left_out)
    work.report_concluding_progress("weighing", 0.0)
    weighed = [found for fit in fits for found in _evidence_with_probability(fit)]
    evidence = [found for found, _ in weighed]
    chance = {id(found.effect_term): likely for found, likely in weighed}
    sure, machine = (_machine_of(fits, chance, least) for least in (CONFIRMED_PROBABILITY, LIKELY_PROBABILITY))
    errors = tool_errors(whole, [found.effect_term for found in evidence], [fit.cell for fit in fits], sure)
    work.report_concluding_progress("localising", 0.6)
    before, after = localise(whole), localise(_with_effects(whole, entries_of(sure)))
    work.report_concluding_progress("held-out data", 0.8)
    predicted = tuple(held_out(fit.cell, fit_of(fit.best_fit.current_terms, fit.best_fit.linear_model)) for fit in fits)
    closing = tuple(tuple(gaps_closed(prediction)) for prediction in predicted)
    columns = tuple(_budget_column(whole, error, chance, fits, sure, predicted) for error in errors)
    total = sum(column.before_mm**2 for column in columns)
    lines = tuple(
        line for error in errors for line in _effect_lines(error, evidence, chance, total)
    ) + _lines_without_tool_error(evidence, errors, chance)
    lines = tuple(sorted(lines, key=lambda line: (-line.share_frac, -line.tool_rms_mm)))
    stages = stages_of(whole, lines, columns, (before, after), fits, closing)
    verdict, why = verdict_of(whole, lines, columns, stages, fits, closing)
    where = beyond_noise(before, {(line.stage, line.joint): line.before_mm or 0.0 for line in stages})
    return Budget(whole, fits, lines, machine, columns, stages, where, predicted, closing, verdict, why)


def _evidence_with_probability(fit: WholeFit) -> list[tuple[Evidence, float]]:
    """The evidence of a part's effects, each with its probability.

    Given a baseline, an effect has to hold without those that are doubtful as well: two of them may stand together for
    something that the catalogue does not have. Without one, many small effects are truly there and yet doubtful.
    """
    found = [(evidence, probability(evidence)) for evidence in evidence_of(fit)]
    held = [evidence.effect_term for evidence, likely in found if likely >= LIKELY_PROBABILITY]
    if fit.cell.baseline_gain_nats is None or len(held) in (0, len(found)):
        return found
    again = {
        alone.effect_term.effect.without_variant: probability(alone) for alone in evidence_of(refit_reduced(fit, held))
    }
    return [
        (evidence, min(likely, again.get(evidence.effect_term.effect.without_variant, likely)))
        for evidence, likely in found
    ]


def _machine_of(fits: Iterable[WholeFit], chance: dict[int, float], least: float) -> tuple[EffectTerm, ...]:
    """The effects of at least this probability, each part's fitted as if it had no other."""
    some = [term for fit in fits for term in fit.best_fit.current_terms if chance.get(id(term), 0.0) >= least]
    return tuple(term for fit in fits for term in refit_terms(fit, some))


def _with_effects(whole: Read, entries: tuple[EffectEntry, ...]) -> Read:
    nominal = whole.nominal_machine
    return (
        whole
        if nominal is None
        else replace(whole, nominal_machine=replace(nominal, baseline_effects=(*nominal.baseline_effects, *entries)))
    )


def _effect_lines(
    error: ToolError, evidence: list[Evidence], chance: dict[int, float], total_mm2: float
) -> list[EffectLine]:
    by_term = {id(found.effect_term): found for found in evidence}
    out = []
    for term, rms, squares in zip(error.effect_terms, error.rms_m * MM, error.squares_m2 * MM**2, strict=True):
        one = by_term[id(term)]
        sizes = term.theta[: term.size_count]
        size = float(np.linalg.norm(sizes)) if not term.limits else 1.0
        sd = float(np.linalg.norm(one.size_sd * sizes) / size) if not term.limits and size > 0.0 else 0.0
        spread = NORMAL_QUANTILE_95 * sd / size if size > 0.0 else 0.0
        out.append(
            EffectLine(
                one,
                error.budget_column,
                float(rms),
                float(rms) * max(0.0, 1.0 - spread),
                float(rms) * (1.0 + spread),
                float(squares),
                float(squares) / total_mm2 if total_mm2 > 0.0 else 0.0,
                chance[id(term)],
            )
        )
    return out


def _lines_without_tool_error(
    evidence: list[Evidence], errors: tuple[ToolError, ...], chance: dict[int, float]
) -> tuple[EffectLine, ...]:
    """Effects of which nothing says what they do at the tool (no arm in the machine file, no controller)."""
    placed = {id(term) for error in errors for term in error.effect_terms}
    return tuple(
        EffectLine(found, "", 0.0, 0.0, 0.0, 0.0, 0.0, chance[id(found.effect_term)])
        for found in evidence
        if id(found.effect_term) not in placed
    )


def _budget_column(
    whole: Read,
    error: ToolError,
    chance: dict[int, float],
    fits: tuple[WholeFit, ...],
    sure: Sequence[EffectTerm],
    predicted: tuple[HeldOut, ...],
) -> BudgetColumn:
    """One column's miss before and after; measured where the recording measured it."""
    chosen = [k for k, term in enumerate(error.effect_terms) if chance[id(term)] >= CONFIRMED_PROBABILITY]
    explained = error.by_effect[chosen].sum(axis=0) if chosen else np.zeros_like(error.total_error)
    if error.measured_error_m is not None and error.remaining_error_m is not None:
        floor = _tracking_floor_mm(whole)
        return BudgetColumn(
            error.budget_column,
            _rms_mm(error.measured_error_m, floor),
            _rms_mm(error.remaining_error_m, floor),
            floor,
            True,
        )
    seen = error.budget_column == "sees"
    if seen:
        left = _largest_miss_mm(whole, CornerResidual, [(fit.cell, fit.best_fit.linear_model.residual) for fit in fits])
    else:
        left = _largest_miss_mm(whole, PointResidual, [(fit.cell, _residual_with(fit.cell, sure)) for fit in fits])
    if left is None:  # nothing measured it: all that is known is what the confirmed effects do
        return BudgetColumn(error.budget_column, _rms_mm(explained), 0.0, 0.0, False)
    after, floor = left
    if seen:  # a mean error of corners says little of the distance: what the effects that are not confirmed do is added
        before = together_mm((_rms_mm(error.total_error), after))
        after = together_mm((_rms_mm(error.total_error - explained), after))
    else:  # the larger: an unknown frame takes up a part of what effects do, and a clock's error moves no arm
        nominal = _largest_miss_mm(
            whole, PointResidual, [(each.cell, each.residual_without_effects) for each in predicted]
        )
        before = max(nominal[0] if nominal else 0.0, together_mm((_rms_mm(explained), after)))
    return BudgetColumn(error.budget_column, before, after, floor, True)


def _residual_with(cell: Cell, terms: Sequence[EffectTerm]) -> Array:
    """What a part of the machine leaves (N,), whitened, with those of these effects that it shows and no other."""
    own = {candidate.effect_and_joint for candidate in cell.candidates}
    return cell.whitened(pack_terms(cell, [term for term in terms if term.effect.effect_and_joint in own]))[0]


def _largest_miss_mm(
    whole: Read,
    measured_by: type[PointResidual | CornerResidual],
    residuals: Sequence[tuple[Cell, Array]],
) -> tuple[float, float] | None:
    """The largest miss beyond noise of all that was measured so, with its noise [mm]; None where nothing was."""
    parts = [part for cell, residual in residuals for part in cell.by_part(residual)]
    misses = [_left_and_noise_mm(whole, *part) for part in parts if isinstance(part[0].whitened, measured_by)]
    return max(misses, default=None)


def _left_and_noise_mm(whole: Read, part: Cell, residual: Array) -> tuple[float, float]:
    """What is left of a part beyond its noise, and the noise, as a distance at the tool (RMS) [mm].

    Where nothing measured the noise, all that is left counts. With a baseline, what a healthy machine leaves is noise.
    """
    squares, rows = float((residual**2).sum()), part.rows.row_count
    level = usual_level(whole, part.stage, part.joint, measurement_of(part))
    noise = min(squares, rows * (level if has_baseline(whole) else part.quiet)) if part.floor_known else 0.0
    left = excess_squares(squares, noise, rows)
    unit_mm = MM * float(np.sqrt(np.mean(part.scale**2) / rows))
    if not isinstance(part.whitened, CornerResidual):
        unit_mm *= np.sqrt(3.0)  # three numbers a point
    elif part.whitened.nominal_machine.camera is not None:
        places = (
            part.whitened.poses(part.baseline_parameters, without_encoders(part.baseline_parameters), 0, 0.0)
            @ part.whitened.T_base_ooi
        )
        unit_mm *= float(np.median(np.abs(places[:, 2, 3]))) / part.whitened.nominal_machine.camera.fx_px
    return unit_mm * float(np.sqrt(left)), unit_mm * float(np.sqrt(noise))


def _rms_mm(displacement: Array, floor_mm: float = 0.0) -> float:
    mean_square = float((displacement**2).sum(axis=1).mean()) * MM**2 if len(displacement) else 0.0
    return float(np.sqrt(max(0.0, mean_square - floor_mm**2)))


def _tracking_floor_mm(whole: Read) -> float:
    """By how much repeats of one command differ at the tool (RMS) [mm]; 0 without repeats."""
    nominal = whole.nominal_machine
    squares = []
    for members in repeat_groups(whole.stretches).values():
        if nominal is None or nominal.arm is None or any(stretch.enc is None for stretch in members):
            continue
        laid = align_repeats(members, [np.nan_to_num(stretch.enc) for stretch in members if stretch.enc is not None])
        flat = laid.reshape(-1, nominal.n)
        at = tcp_poses(nominal.arm, neutral_sets(nominal.n), flat)[:, :3, 3].reshape(*laid.shape[:2], 3)
        off = at - at.mean(axis=0)
        squares.append(float((off**2).sum(axis=2).mean()) * len(laid) / (len(laid) - 1.0))
    return MM * float(np.sqrt(np.mean(squares))) if squares else 0.0
