"""The whole machine fitted part by part: all that is measured behind the encoders, link, controllers, actuators.

Parts share no number but what an earlier one found of a later one's input: the encoders' own errors, the link's delay.
"""

from dataclasses import replace

import numpy as np

from diagnosis.cells.behind import behind_cells, cells_fitting_joint, cells_without, shown_behind
from diagnosis.cells.dynamic import coupled_cell, stage_cells
from diagnosis.cells.merged import merged_cells
from diagnosis.cells.own_step import at_its_step
from diagnosis.known.known import with_known
from diagnosis.reading.read import Read
from diagnosis.replay.replayer import Replayer, replayer_of
from diagnosis.search.candidates import (
    ENCODER_VISIBLE_EFFECTS,
    SUPPLY_DROOP_EFFECT,
    Candidate,
    parameter_sets_with,
    with_baseline_shapes,
)
from diagnosis.search.cell import DYNAMIC_STAGES, Cell
from diagnosis.search.fit import neutral_fit
from diagnosis.search.work import WorkProgress
from diagnosis.whole_model.guessed_noise import NOISE_CONVERGENCE_FRAC, by_noise_of, noise_about
from diagnosis.whole_model.invariant import most_invariant
from diagnosis.whole_model.linear import EffectTerm, linearise_terms
from diagnosis.whole_model.solve import WholeFit, fit_and_prune, fit_of, score_at, trusted_rows
from diagnosis.whole_model.subsets import best_set
from machine.effects.entries import pack_under
from machine.effects.layout import ParameterSets

DEADBAND, GAIN = "valve_deadband", "flow_gain_error"
ALTERNATIVE_EFFECT_OPTIONS = {
    DEADBAND: "kept",
    "stiction": "at_reversals",
}  # tried in place of the first one, never together with it


def fit_machine(whole: Read, work: WorkProgress | None = None, left_out: tuple[str, ...] = ()) -> tuple[WholeFit, ...]:
    """Every part that the recording allows, fitted by all of its effects together. `left_out`: effects not tried."""
    nominal = whole.nominal_machine
    if nominal is None:
        return ()
    work = work or WorkProgress()
    base = pack_under(nominal.baseline_effects, nominal.n)
    replayer = replayer_of(nominal, whole.stretches) if whole.stretches else None
    cells = behind_cells(whole, base, with_odometry=not nominal.baseline_remainders)
    behind = cells_without(cells_fitting_joint(cells, nominal), left_out)
    found = _solve_cells(behind, work)
    if replayer is None:
        return tuple(found)
    unseen = (*left_out, *shown_behind(behind))
    known = with_found(base, found, ENCODER_VISIBLE_EFFECTS)
    replayer = at_its_step(replayer, whole.stretches, known)
    course = known
    for stage in DYNAMIC_STAGES:
        cells = with_known(stage_cells(stage, replayer, whole.stretches, known, course), nominal)
        cells = cells_fitting_joint(cells, nominal)
        own = _solve_cells(cells_without(cells, unseen), work)
        if stage == "actuator" and SUPPLY_DROOP_EFFECT not in left_out:
            own = _shared_flow(own, replayer, whole, (known, course))
        course = with_found(course, own)
        found += own
    one_by_one, _ = merged_cells(replayer, whole.stretches, known, course)
    return (*found, *_solve_cells(cells_without(cells_fitting_joint(one_by_one, nominal), unseen), work))


def _solve_cells(cells: list[Cell], work: WorkProgress) -> list[WholeFit]:
    out = []
    work.begin_cells(cells)
    for cell in cells:
        work.begin(f"fitting {cell.label}")
        out.append(most_invariant(_in_other_form(_solved_by_its_noise(cell, work))))
        work.end_cell()
    return out


def _solved_by_its_noise(cell: Cell, work: WorkProgress) -> WholeFit:
    """A part's fit; where its noise was never measured, by the noise that all effects together leave (REML)."""
    noise = None if cell.at_noise is None else noise_about(cell, neutral_fit(cell))
    if cell.at_noise is None or noise is None:
        return fit_and_prune(cell, library_of(cell))
    found = fit_and_prune(by_noise_of(cell, cell.at_noise(noise)), library_of(cell))
    again = noise_about(cell, fit_of(found.best_fit.current_terms, found.best_fit.linear_model))
    if (
        again is None
        or float(np.abs(np.log(again.innovation_sigma / noise.innovation_sigma)).max()) < NOISE_CONVERGENCE_FRAC
    ):
        return found
    work.repeat_cell()
    return fit_and_prune(by_noise_of(cell, cell.at_noise(again)), (), found.best_fit.current_terms)


def library_of(cell: Cell) -> tuple[Candidate, ...]:
    """A cell's effects, each in one form; given a baseline, with the shapes of the baseline's own effects."""
    forms = (
        effect for effect in cell.candidates if ALTERNATIVE_EFFECT_OPTIONS.get(effect.name) != effect.variant_option
    )
    return with_baseline_shapes(cell.baseline_parameters, tuple(forms))


def _in_other_form(found: WholeFit) -> WholeFit:
    """The fit with effects in their other form where that explains more.

    A dead band that keeps the full flow is the same as one that loses flow, together with a gain. So it takes the place
    of both, and of none where a gain stays.
    """
    forms = {
        effect.effect_and_joint: effect
        for effect in found.cell.candidates
        if ALTERNATIVE_EFFECT_OPTIONS.get(effect.name) == effect.variant_option
    }
    for k, term in enumerate(found.best_fit.current_terms):
        form = forms.get(term.effect.effect_and_joint)
        if not term.is_present or form is None or form == term.effect:
            continue
        gain = (GAIN, term.effect.joint) if term.effect.name == DEADBAND else None
        if gain is not None and not _has_present_term(found.best_fit.current_terms, gain):
            continue
        others = tuple(
            replace(other, is_present=other.is_present and other.effect.effect_and_joint != gain)
            for other in found.best_fit.current_terms
        )
        tried = fit_and_prune(found.cell, (), (*others[:k], replace(others[k], effect=form), *others[k + 1 :]))
        if gain is not None and _has_present_term(tried.best_fit.current_terms, gain):
            continue
        if score_at(tried.best_fit.linear_model, found.correlation_weight) > score_at(
            found.best_fit.linear_model, found.correlation_weight
        ):
            found = tried
    return found


def _has_present_term(terms: tuple[EffectTerm, ...], key: tuple[str, int | None]) -> bool:
    return any(term.is_present and term.effect.effect_and_joint == key for term in terms)


def with_found(base: ParameterSets, fits: list[WholeFit], names: tuple[str, ...] | None = None) -> ParameterSets:
    """A parameter set with the effects found, or with those of these names."""
    for fit in fits:
        for term in fit.best_fit.current_terms:
            if term.is_present and (names is None or term.effect.name in names):
                base = parameter_sets_with(base, (term.effect,), term.theta)
    return base


def _shared_flow(
    own: list[WholeFit], replayer: Replayer, whole: Read, known: tuple[ParameterSets, ParameterSets]
) -> list[WholeFit]:
    """The actuators together, where a pump that limits their sum explains more than they do one by one."""
    cell = coupled_cell(replayer, whole.stretches, *known)
    if cell is None or len(own) != len(replayer.plant.joints):
        return own
    apart = tuple(term for fit in own for term in fit.best_fit.current_terms if term.is_present)
    terms = (*apart, *(EffectTerm(effect, effect.scan_points()[0], False) for effect in cell.candidates))
    lin = linearise_terms(cell, terms)
    best = best_set(lin.choice_problem(trusted_rows(cell, apart)), lin.present_terms, np.ones(len(terms), dtype=bool))
    if not best[len(apart) :].any():
        return own
    together = fit_and_prune(cell, (), terms)
    if not any(term.is_present and term.effect.name == SUPPLY_DROOP_EFFECT for term in together.best_fit.current_terms):
        return own
    everything = tuple(term for fit in own for term in fit.best_fit.current_terms)
    return [fit_and_prune(replace(cell, candidates=()), (), _with_states(everything, together.best_fit.current_terms))]


def _with_states(terms: tuple[EffectTerm, ...], known: tuple[EffectTerm, ...]) -> tuple[EffectTerm, ...]:
    """Terms as another fit found them, where it has them; with what it has besides."""
    by_variant = {term.effect.without_variant: term for term in known}
    mine = tuple(by_variant.pop(term.effect.without_variant, term) for term in terms)
    return (*mine, *by_variant.values())
