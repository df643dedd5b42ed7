"""The baseline of a machine: effects that belong to it undisturbed, and what they leave of the model's form.

Fitted on some recordings, judged on others. Why a remainder at all: docs/decisions/0011-baseline.md.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.candidates import Candidate, put
from diagnosis.cells import DRIVEN_STAGES, Cell
from diagnosis.cells_behind import joined, measurement_of
from diagnosis.errors import DiagnosisError
from diagnosis.fit import Fit, costs, evaluated, fit, neutral_fit
from diagnosis.form import TOGETHER_MIN
from diagnosis.left_over import cells_of, forms_of, remainders_of, with_baseline, with_mosts, with_wanders
from diagnosis.reading import Read
from diagnosis.refusal import at_edge, key_of, pattern_nats, steady_energy, tests_of
from diagnosis.scan import FELT, Scan, foreseen, scan
from diagnosis.score import Score, better, numbers_of, score
from diagnosis.search import Search, search
from diagnosis.shapes.found import shapes_of
from machine.effects.entries import EffectEntry, make_entry
from machine.effects.registry import effect_named
from machine.errors import MachineFileError
from machine.remainder import SHARE_MIN, USUAL_ENERGY, USUAL_NAME, USUAL_NATS, Remainder, usual_name, usual_shape
from machine.rotations import Array

EFFECTS_MAX = 9  # in one cell
TRIED = 3  # of the best scanned, fitted at each step
ROUNDS = 5
PASSES = 3  # at most, each by the floor that the one before it left
FEW = 2
CHANCE_NATS = 4.5  # that the best of some dozen wrong names gains by chance: three quarters of the margin of a name
CHANCE_MORE_NATS = 2.0  # for each further number that it may choose
CHECKED_MIN = 2  # recordings that the baseline is judged on
FOLDS = 3  # of the recordings, each judged by the form of the others
DAYS_OWN = 10  # from so many on, each joint has its own usual tests
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class CellBaseline:
    """What was found for one cell: RMS in floors before and with the effects, on recordings not used for the fit."""

    label: str
    effects: tuple[EffectEntry, ...]
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class Baseline:
    """Effects and remainders for the machine file. `best_wrong`: by cell, what the best wrong name usually gains, over
    chance; `usual_names`: those that gain more than that, and what [nats].
    """

    effects: tuple[EffectEntry, ...]
    remainders: tuple[Remainder, ...]
    cells: tuple[CellBaseline, ...]
    best_wrong: tuple[tuple[str, float], ...]
    usual_names: tuple[tuple[str, float], ...] = ()


def fit_baseline(fitted: list[Read], checked: list[Read], progress: Progress = lambda _text: None) -> Baseline:
    """A baseline from undisturbed recordings of one machine.

    Raises: DiagnosisError: fewer than one recording to fit or two to judge, or nothing in them to replay.
    """
    if not fitted or len(checked) < CHECKED_MIN:
        raise DiagnosisError(
            f"{len(fitted)} recordings to fit and {len(checked)} to judge; give at least 1 and {CHECKED_MIN}"
        )
    wholes = [*fitted, *checked]
    entries = _sized(wholes, _settled(fitted, progress), progress)
    progress("what the model is wrong by on all recordings alike")
    forms = _forms(wholes, entries)
    foretold = _foretold(wholes, entries, forms)[len(fitted) :]
    progress("what is left on the other recordings")
    seen = _beside(checked, entries, foretold)
    left = remainders_of(seen)
    progress("what its numbers wander by from day to day")
    left = with_wanders(left, _beside(checked, entries, foretold, left))
    remainders = _with_forms(left, forms)
    remainders = with_mosts(remainders, [with_baseline(one, entries, remainders) for one in wholes])
    spreads, usual, names = _wrong_gains(_beside(checked, entries, foretold, left), progress)
    finished = _spread(tuple(_with_usual(one, usual, len(checked)) for one in remainders), spreads, names)
    return Baseline(entries, finished, _judged(checked, seen, entries), tuple(spreads.items()), _told(names))


def _forms(wholes: list[Read], entries: tuple[EffectEntry, ...]) -> tuple[Remainder, ...]:
    """What the effects leave of all recordings alike, each weighed by what it is left with."""
    left = remainders_of([with_baseline(one, entries, ()) for one in wholes])
    return forms_of([with_baseline(one, entries, left) for one in wholes])


def _foretold(
    wholes: list[Read], entries: tuple[EffectEntry, ...], forms: tuple[Remainder, ...]
) -> list[tuple[Remainder, ...]]:
    """For each recording the form that the others have; with few of them the form of all.

    Why: a form has some hundred numbers, and what it leaves of the recordings that it was fitted to is less than of
    the next one.
    """
    if len(wholes) < FOLDS * TOGETHER_MIN:
        return [forms for _ in wholes]
    apart = [_forms([one for k, one in enumerate(wholes) if k % FOLDS != fold], entries) for fold in range(FOLDS)]
    return [apart[k % FOLDS] for k in range(len(wholes))]


def _beside(
    wholes: list[Read],
    entries: tuple[EffectEntry, ...],
    foretold: list[tuple[Remainder, ...]],
    left: tuple[Remainder, ...] | None = None,
) -> list[Read]:
    """Recordings with these effects, each with the form that is foretold of it, and with what that leaves if known."""
    own = [forms if left is None else _with_forms(left, forms) for forms in foretold]
    return [with_baseline(one, entries, remainders) for one, remainders in zip(wholes, own, strict=True)]


def _with_forms(remainders: tuple[Remainder, ...], forms: tuple[Remainder, ...]) -> tuple[Remainder, ...]:
    known = {(one.stage, one.joint, one.on): one.form for one in forms}
    return tuple(replace(one, form=known.get((one.stage, one.joint, one.on), ())) for one in remainders)


def _told(names: dict[str, dict[str, float]]) -> tuple[tuple[str, float], ...]:
    return tuple((name.removeprefix(USUAL_NAME), nats) for found in names.values() for name, nats in found.items())


def _settled(fitted: list[Read], progress: Progress) -> dict[str, Fit]:
    """Effects of each cell by the floor that they leave themselves, fitted again until their names stay.

    Why: the oil swings by several floors. Weighed by the noise alone, that swing decides what is worth fitting; by the
    filter that whitens it, and by what each kind of measurement is left with, small effects beside it are seen.
    """
    entries: tuple[EffectEntry, ...] = ()
    remainders: tuple[Remainder, ...] = ()
    found: dict[str, Fit] = {}
    for number in range(1, PASSES + 1):
        before = [(one.name, one.joint) for one in entries]
        groups = _grouped([with_baseline(one, (), remainders) for one in fitted])
        if not groups:
            raise DiagnosisError("no stage of these recordings can be replayed; see `longreach recording check`")
        for label, cell in groups.items():
            progress(f"fitting {label}, pass {number} of at most {PASSES}")
            found[label] = forward(cell).fit
        entries = tuple(entry for one in found.values() for entry in entries_of(one))
        if [(one.name, one.joint) for one in entries] == before:
            break
        remainders = remainders_of([with_baseline(one, entries, ()) for one in fitted])
    return found


def _sized(wholes: list[Read], fits: dict[str, Fit], progress: Progress) -> tuple[EffectEntry, ...]:
    """The sizes of the effects that were found, by cell, fitted again on all recordings.

    Why on those, too, that judge: three recordings know a flow gain to half a percent, and every later one would show
    the rest as a name. Two dozen numbers gain a nat each by it; it is the names that have to stand the test.
    """
    first = tuple(entry for one in fits.values() for entry in entries_of(one))
    remainders = remainders_of([with_baseline(one, first, ()) for one in wholes])
    found: list[EffectEntry] = []
    for label, cell in _grouped([with_baseline(one, (), remainders) for one in wholes]).items():
        if label in fits and fits[label].hypothesis:
            progress(f"sizes of {label} on {len(wholes)} recordings")
            found += entries_of(fit(cell, fits[label].hypothesis, fits[label].theta, ROUNDS))
    return tuple(found)


def _grouped(wholes: list[Read]) -> dict[str, Cell]:
    """The same cell of all recordings as one, by its label."""
    found: dict[str, list[Cell]] = {}
    for whole in wholes:
        for cell in cells_of(whole):
            found.setdefault(cell.label, []).append(cell)
    return {label: joined(cells) if len(cells) > 1 else cells[0] for label, cells in found.items()}


def forward(cell: Cell) -> Score:
    """Effects added one by one while they pass the margin, all refitted each time; then dropped where not needed.

    The margin is counted in units of what the best model leaves (chi2/n): a plant's form is never met to the floor. It
    is no share of what is gained in all, as a diagnosis asks: what is small and steady belongs to the machine, too.
    A size at the end of what is believed of it is no usual state: the cause is another one, which has no name.
    """
    none = chosen = score(cell, neutral_fit(cell))
    scans = [scan(cell, one, none.fit) for one in cell.candidates]
    while len(chosen.fit.hypothesis) < EFFECTS_MAX:
        tried = [_more(cell, chosen, one) for one in _promising(cell, chosen.fit, scans)]
        found = [one for one in tried if not at_edge(cell, one)]
        best = max(found, key=lambda one: one.total, default=None)
        if best is None or not better(best, chosen, chosen, _left(best)):
            break
        chosen = best
    return _pruned(cell, chosen)


def _left(one: Score) -> float:
    return max(1.0, float(np.mean(np.minimum(one.held_out**2, 100.0))))


def _promising(cell: Cell, found: Fit, scans: list[Scan]) -> list[tuple[Candidate, Array]]:
    """The best candidates on top of a fit, each at a few sizes about what moves the residual by ten floors."""
    used = {one.key for one in found.hypothesis}
    on_top = replace(cell, base=put(cell.base, found.hypothesis, found.theta))
    ranked: list[tuple[float, Candidate, Array]] = []
    for one in scans:
        if one.candidate.key in used:
            continue
        tried = one.thetas
        if found.hypothesis:
            few = _few(one)
            changes = evaluated(on_top, (one.candidate,), few) - found.residual
            tried = np.concatenate([few, foreseen(one.candidate, few, changes, found.residual)])
        totals = costs(evaluated(on_top, (one.candidate,), tried)).sum(axis=1)
        ranked.append((float(totals.min()), one.candidate, tried[int(np.argmin(totals))]))
    ranked.sort(key=lambda row: row[0])
    return [(candidate, theta) for _, candidate, theta in ranked[:TRIED]]


def _few(one: Scan) -> Array:
    """The scan's best size, and on each side of neutral the smallest that moves the residual clearly."""
    if one.candidate.vector:
        return one.thetas
    felt = np.nonzero(one.energy > FELT)[0]
    order = felt[np.argsort(one.energy[felt])][:FEW]
    return one.thetas[np.unique(np.append(order, one.best))]


def _more(cell: Cell, chosen: Score, added: tuple[Candidate, Array]) -> Score:
    candidate, theta = added
    start = np.concatenate([chosen.fit.theta, theta])
    return score(cell, fit(cell, (*chosen.fit.hypothesis, candidate), start, ROUNDS))


def _pruned(cell: Cell, chosen: Score) -> Score:
    for out in chosen.fit.hypothesis[:-1]:
        rest = tuple(one for one in chosen.fit.hypothesis if one is not out)
        keep = np.concatenate([np.full(len(one.slots), one is not out) for one in chosen.fit.hypothesis])
        smaller = score(cell, fit(cell, rest, chosen.fit.theta[keep], ROUNDS))
        if not better(chosen, smaller, smaller, _left(chosen)):
            return _pruned(cell, smaller)
    return chosen


def entries_of(found: Fit) -> list[EffectEntry]:
    """A fit as `[[effect]]` entries; sizes that ended at a bound lie on it."""
    out, at = [], 0
    for one in found.hypothesis:
        effect = effect_named(one.name)
        values = found.theta[at : at + len(one.slots)]
        at += len(one.slots)
        if effect is None:
            continue
        parameters: dict[str, object] = {slot.parameter: value for slot, value in one.fixed}
        if effect.direction is not None:
            size = float(np.linalg.norm(values))
            parameters |= {effect.size.name: min(size, effect.size.highest)}
            if size > 0.0:
                along = np.zeros(len(effect.direction.default))  # a base is tilted about its level axes only
                along[: len(values)] = values / size
                parameters[effect.direction.name] = along.tolist()
        else:
            parameters |= {slot.parameter: float(value) for slot, value in zip(one.slots, values, strict=True)}
        if effect.choice is not None and one.option:
            parameters[effect.choice.name] = one.option
        try:
            out.append(make_entry(effect, one.joint, parameters))
        except MachineFileError as error:
            raise DiagnosisError(f"a fitted effect does not fit its own bounds: {error}") from error
    return out


def _beyond_chance(one: Score, none: Score) -> float:
    """What a name gains over what chance gives, which is more for a name with more numbers."""
    return (one.total - none.total) / (CHANCE_NATS + CHANCE_MORE_NATS * max(0, numbers_of(one.fit) - 1))


Names = dict[str, dict[str, tuple[float, float]]]
Usual = dict[tuple[str, int | None, str], dict[str, float]]


def _wrong_gains(
    checked: list[Read], progress: Progress
) -> tuple[dict[str, float], Usual, dict[str, dict[str, float]]]:
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
            told = " + ".join(f"{one.name} {one.joint or ''}".strip() for one in best.fit.hypothesis)
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
    for part, own in cell.by_part(np.clip(residual, -30.0, 30.0)):
        sizes = usual.setdefault((part.stage, part.joint, measurement_of(part)), {})
        for fired in tests_of(part, own, 1):
            sizes[key_of(fired)] = max(sizes.get(key_of(fired), 0.0), fired.size)
        sizes[USUAL_ENERGY] = max(sizes.get(USUAL_ENERGY, 0.0), steady_energy(part, own))
        drowned = max(part.left_share, SHARE_MIN)  # as `usual_at` reads it
        sizes[USUAL_NATS] = max(sizes.get(USUAL_NATS, 0.0), pattern_nats(part, own) / drowned)
        for one in shapes_of(part, own, 0.0):
            key = usual_shape(one.goes_with)
            sizes[key] = max(sizes.get(key, 0.0), one.nats / drowned)


def _with_usual(one: Remainder, usual: Usual, days: int) -> Remainder:
    """A joint keeps its own where enough recordings tell; all joints of a stage the same where few speak for many.

    Few do not tell what the most is that is ever left.
    """
    alike = [
        sizes
        for (stage, joint, on), sizes in usual.items()
        if (stage, on) == (one.stage, one.on) and (joint in (None, one.joint) or days < DAYS_OWN)
    ]
    told = (name for sizes in alike for name in sizes if name != USUAL_ENERGY or days >= DAYS_OWN)
    names = dict.fromkeys(told)
    return replace(one, usual=tuple((name, max(sizes.get(name, 0.0) for sizes in alike)) for name in names))


def _spread(
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


def _judged(checked: list[Read], seen: list[Read], effects: tuple[EffectEntry, ...]) -> tuple[CellBaseline, ...]:
    """RMS in units of the noise floor, before and with the baseline, on recordings whose names were not fitted.

    Args: seen: the same recordings, with the effects and with the form that the others have.
    """
    before, after = _grouped([with_baseline(one, (), ()) for one in checked]), _grouped(seen)
    return tuple(
        CellBaseline(label, effects, _rms(before[label]), _rms(after[label])) for label in before if label in after
    )


def _rms(cell: Cell) -> float:
    return float(np.sqrt(np.mean(cell.whitened(cell.base)[0] ** 2)))
