"""The baseline of a machine: effects that it has without a fault, and what they leave of the model's form.

Fitted on some recordings, judged on others. Why a remainder at all: decision 11 (docs/decisions).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.baseline.left_over import (
    cells_of,
    forms_of,
    mean_square,
    remainders_of,
    with_baseline,
    with_levels,
    with_mosts,
    with_wanders,
)
from diagnosis.cells.behind import join_cells
from diagnosis.errors import DiagnosisError
from diagnosis.known.days import JUDGING_RECORDINGS_TARGET
from diagnosis.known.form import FORM_RECORDINGS_MIN
from diagnosis.reading.read import Read
from diagnosis.search.cell import DYNAMIC_STAGES, Cell
from diagnosis.search.fit import Fit, entries_of, fit_hypothesis
from diagnosis.whole_model.linear import EffectTerm, linearise_terms
from diagnosis.whole_model.parts import library_of
from diagnosis.whole_model.solve import fit_and_prune, fit_of, trusted_rows
from machine.effects.entries import EffectEntry
from machine.remainder import Remainder

# What each effect gains on baseline recordings, by chance and by the error of the machine's model.
Gains = dict[tuple[str, int | None], dict[str, float]]


def usual_gains(checked: list[Read]) -> Gains:
    """By stage and joint, the most that each effect gains when it is the only one [nats], over all recordings.

    What was measured behind the encoders counts as one place, without a joint; so does the link.
    """
    most: Gains = {}
    for cell in (cell for whole in checked for cell in cells_of(whole)):
        terms = tuple(EffectTerm(effect, np.zeros(len(effect.parameter_slots)), False) for effect in library_of(cell))
        lin = linearise_terms(cell, terms)
        problem = lin.choice_problem(trusted_rows(cell, ()))
        none = problem.score(np.zeros(len(terms), dtype=bool))
        place = cell.stage, cell.joint if cell.stage in DYNAMIC_STAGES else None
        gains = most.setdefault(place, {})
        for k, term in enumerate(terms):
            gain = problem.score(np.arange(len(terms)) == k) - none - float(problem.log_odds[k])
            gains[term.effect.name] = max(gains.get(term.effect.name, 0.0), float(gain))
    return most


MAX_SELECTION_PASSES = 3  # at most, each by the floor that the one before it left
JUDGING_RECORDINGS_MIN = 2  # recordings that the baseline is judged on
MAX_ITERATIONS = 5  # of a fit of the sizes
CROSS_VALIDATION_FOLDS = 3  # of the recordings, each judged by the form of the others
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class CellBaseline:
    """What was found for one cell: RMS in floors before and with the effects, on recordings not used for the fit."""

    cell_label: str
    effects: tuple[EffectEntry, ...]
    rms_without_effects: float
    rms_with_effects: float


@dataclass(frozen=True, slots=True)
class Baseline:
    """Effects and remainders for the machine file."""

    effects: tuple[EffectEntry, ...]
    remainders: tuple[Remainder, ...]
    cell_baselines: tuple[CellBaseline, ...]


def fit_baseline(fitted: list[Read], checked: list[Read], progress: Progress = lambda _text: None) -> Baseline:
    """A baseline from recordings of one machine without a fault.

    Raises: DiagnosisError: fewer than one recording to fit or two to judge, or nothing in them to replay.
    """
    wholes = [*fitted, *checked]
    if not fitted or len(checked) < JUDGING_RECORDINGS_MIN:
        raise DiagnosisError(
            f"a baseline from {len(wholes)} recordings: give at least {1 + JUDGING_RECORDINGS_MIN}, of which 1 is "
            f"fitted and {JUDGING_RECORDINGS_MIN} judge"
        )
    entries = _refit_effect_sizes(wholes, _fit_until_effects_stable(fitted, progress), progress)
    progress("what the model is wrong by on all recordings alike")
    forms = _common_remainder_forms(wholes, entries)
    predicted = _cross_validated_forms(wholes, entries, forms)[len(fitted) :]
    progress("what is left on the other recordings")
    seen = _with_predicted(checked, entries, predicted)
    left = remainders_of(seen)
    progress("what its numbers wander by from day to day")
    left = with_wanders(left, _with_predicted(checked, entries, predicted, left))
    judged = _with_predicted(checked, entries, predicted, left)
    left = with_levels(left, judged)
    remainders = _with_forms(left, forms)
    remainders = with_mosts(remainders, [with_baseline(recording, entries, remainders) for recording in wholes])
    progress("what each effect gains on the other recordings")
    gains = usual_gains(judged)
    return Baseline(entries, with_usual(remainders, gains, len(checked)), _evaluate_baseline(checked, seen, entries))


def with_usual(remainders: tuple[Remainder, ...], gains: Gains, days: int) -> tuple[Remainder, ...]:
    """Remainders with what each effect gains there; of few recordings the most of any joint counts for all of them."""
    out = []
    for remainder in remainders:
        joints = [joint for stage, joint in gains if stage == remainder.stage and remainder.on == ""]
        if days >= JUDGING_RECORDINGS_TARGET and remainder.joint in joints:
            joints = [remainder.joint]
        most: dict[str, float] = {}
        for own in (gains[remainder.stage, joint] for joint in joints):
            most = {name: max(nats, most.get(name, 0.0)) for name, nats in {**most, **own}.items()}
        out.append(replace(remainder, usual=tuple(most.items())))
    behind = [(stage, own) for (stage, _), own in gains.items() if stage not in DYNAMIC_STAGES]
    return (*out, *(Remainder(stage, None, "", 0.0, 0.0, usual=tuple(own.items())) for stage, own in behind))


def _common_remainder_forms(wholes: list[Read], entries: tuple[EffectEntry, ...]) -> tuple[Remainder, ...]:
    """What the effects leave of all recordings alike, each weighed by what it is left with."""
    left = remainders_of([with_baseline(recording, entries, ()) for recording in wholes])
    return forms_of([with_baseline(recording, entries, left) for recording in wholes])


def _cross_validated_forms(
    wholes: list[Read], entries: tuple[EffectEntry, ...], forms: tuple[Remainder, ...]
) -> list[tuple[Remainder, ...]]:
    """For each recording the form that the others have; with few of them the form of all.

    Why: a form has some hundred numbers, and what it leaves of the recordings that it was fitted to is less than of
    the next one.
    """
    if len(wholes) < CROSS_VALIDATION_FOLDS * FORM_RECORDINGS_MIN:
        return [forms for _ in wholes]
    apart = [
        _common_remainder_forms(
            [recording for k, recording in enumerate(wholes) if k % CROSS_VALIDATION_FOLDS != fold], entries
        )
        for fold in range(CROSS_VALIDATION_FOLDS)
    ]
    return [apart[k % CROSS_VALIDATION_FOLDS] for k in range(len(wholes))]


def _with_predicted(
    wholes: list[Read],
    entries: tuple[EffectEntry, ...],
    predicted: list[tuple[Remainder, ...]],
    left: tuple[Remainder, ...] | None = None,
) -> list[Read]:
    """Recordings with these effects, each with the form predicted for it, and with what that leaves if known."""
    own = [forms if left is None else _with_forms(left, forms) for forms in predicted]
    return [with_baseline(recording, entries, remainders) for recording, remainders in zip(wholes, own, strict=True)]


def _with_forms(remainders: tuple[Remainder, ...], forms: tuple[Remainder, ...]) -> tuple[Remainder, ...]:
    known = {(form.stage, form.joint, form.on): form.form for form in forms}
    return tuple(
        replace(remainder, form=known.get((remainder.stage, remainder.joint, remainder.on), ()))
        for remainder in remainders
    )


def _fit_until_effects_stable(fitted: list[Read], progress: Progress) -> dict[str, Fit]:
    """Effects of each cell by the floor that they leave themselves, fitted again until their names stay.

    Why: the oil oscillates by several floors. Weighed by the noise alone, that oscillation decides what is worth
    fitting. Weighed by the filter that whitens it, and by what each kind of measurement is left with, smaller effects
    are seen as well.
    """
    entries: tuple[EffectEntry, ...] = ()
    remainders: tuple[Remainder, ...] = ()
    found: dict[str, Fit] = {}
    for number in range(1, MAX_SELECTION_PASSES + 1):
        before = [(effect.name, effect.joint) for effect in entries]
        groups = _cells_by_label([with_baseline(recording, (), remainders) for recording in fitted])
        if not groups:
            raise DiagnosisError("no stage of these recordings can be replayed; see `longreach recording check`")
        for label, cell in groups.items():
            progress(f"fitting {label}, pass {number} of at most {MAX_SELECTION_PASSES}")
            found[label] = _fit_all_effects(cell)
        entries = tuple(entry for fitting in found.values() for entry in entries_of(fitting))
        if [(effect.name, effect.joint) for effect in entries] == before:
            break
        remainders = remainders_of([with_baseline(recording, entries, ()) for recording in fitted])
    return found


def _fit_all_effects(cell: Cell) -> Fit:
    """All effects of a cell together, pruned."""
    best = fit_and_prune(cell, library_of(cell)).best_fit
    return fit_of(best.current_terms, best.linear_model)


def _refit_effect_sizes(wholes: list[Read], fits: dict[str, Fit], progress: Progress) -> tuple[EffectEntry, ...]:
    """The sizes of the effects that were found, by cell, fitted again on all recordings.

    Why on those, too, that judge: three recordings know a flow gain to half a percent, and every later one would show
    the rest as a name. Two dozen numbers gain a nat each by it; it is the names that have to stand the test.
    """
    first = tuple(entry for fitting in fits.values() for entry in entries_of(fitting))
    remainders = remainders_of([with_baseline(recording, first, ()) for recording in wholes])
    found: list[EffectEntry] = []
    for label, cell in _cells_by_label([with_baseline(recording, (), remainders) for recording in wholes]).items():
        if label in fits and fits[label].hypothesis:
            progress(f"sizes of {label} on {len(wholes)} recordings")
            found += entries_of(fit_hypothesis(cell, fits[label].hypothesis, fits[label].theta, MAX_ITERATIONS))
    return tuple(found)


def _cells_by_label(wholes: list[Read]) -> dict[str, Cell]:
    """The same cell of all recordings as one, by its label."""
    found: dict[str, list[Cell]] = {}
    for whole in wholes:
        for cell in cells_of(whole):
            found.setdefault(cell.label, []).append(cell)
    return {label: join_cells(cells) if len(cells) > 1 else cells[0] for label, cells in found.items()}


def _evaluate_baseline(
    checked: list[Read], seen: list[Read], effects: tuple[EffectEntry, ...]
) -> tuple[CellBaseline, ...]:
    """RMS in units of the noise floor, before and with the baseline, on recordings whose names were not fitted.

    Args: seen: the same recordings, with the effects and with the form that the others have.
    """
    before, after = _cells_by_label([with_baseline(recording, (), ()) for recording in checked]), _cells_by_label(seen)
    return tuple(
        CellBaseline(label, effects, _cell_rms(before[label]), _cell_rms(after[label]))
        for label in before
        if label in after
    )


def _cell_rms(cell: Cell) -> float:
    return float(np.sqrt(mean_square(cell)))
