"""From a recording to an answer: cells, search, refusal, probabilities. Reads like the method."""

from dataclasses import dataclass, replace

from diagnosis.cells.behind import behind_cells, energies, fitting, told_behind, without
from diagnosis.cells.dynamic import coupled_cell, stage_cells
from diagnosis.cells.merged import merged_cells
from diagnosis.chain.common_wait import on_their_line
from diagnosis.chain.coupling import with_coupling
from diagnosis.chain.guessed_noise import searched
from diagnosis.chain.own_cycle import at_its_cycle, unseen_wait
from diagnosis.chain.own_step import at_its_step
from diagnosis.chain.unlike import far_off, marked, told_beyond, told_who_sticks
from diagnosis.known.known import with_known
from diagnosis.localise import Localisation, localise, speed_floors
from diagnosis.reading.read import Read
from diagnosis.refusal.gear import gears
from diagnosis.refusal.oil import swinging
from diagnosis.refusal.remainder import Fired, at_edge, remainder
from diagnosis.refusal.shapes import instead, left_shapes, refusing
from diagnosis.replay.replayer import Replayer, replayer_of
from diagnosis.replay.stage_replay import Replay
from diagnosis.replay.stretches import encoder_steps, stood_still
from diagnosis.search.candidates import DROOP, SEEN_BY_ENCODER, put
from diagnosis.search.cell import DRIVEN_STAGES, FORM_SHARE, Cell
from diagnosis.search.limits import Interval, detection_limit, intervals
from diagnosis.search.score import Score
from diagnosis.search.search import Search, searched_again
from diagnosis.search.work import Progress, Work, silent
from diagnosis.verdict.by_itself import moves_by_itself
from diagnosis.verdict.cell_answer import CellAnswer
from diagnosis.verdict.maybe_none import maybe_none
from diagnosis.verdict.shared_gain import shared_gain
from diagnosis.verdict.shrink import shrinks, squares
from diagnosis.verdict.stage_evidence import nats_by_stage
from diagnosis.verdict.verdict import Verdict, verdict_of
from diagnosis.verdict.weigh import Weighed, Whole, combined, same_here, settled, weighed
from machine.effects.entries import pack_under
from machine.effects.layout import ParameterSets

FORM_SHARE_LEAST = 0.0002  # of what was gained before, that a guessed input is wrong by in any case
SHARED = 0.15  # of what a joint's actuator gains: the next joint's has to gain more to have a cause of its own
SHARED_UNKNOWN = 0.02  # the same where no baseline is known: there every joint has its own faults
UNEXPLAINED_SHARE = 0.05  # of the residual beyond the floor, that a name has to explain of a joint's whole loop
TOLD_ODDS = 3.0  # of the names told against fewer of them
TOLD_ODDS_GUESSED = 10.0  # the same where the noise is a guess: what foretells a little of it is there at once
CHOSEN_SHARE = 0.6  # of the two's probability, for a hypothesis that passed the margin against one that scored more


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The whole answer. `numbers`: limits of every number of the reported hypotheses, by their score's identity."""

    whole: Read
    verdict: Verdict
    cells: tuple[CellAnswer, ...]
    hypotheses: tuple[Whole, ...]
    numbers: dict[int, tuple[Interval, ...]]
    localisation: Localisation


def diagnose(whole: Read, progress: Progress = silent, lacking: tuple[str, ...] = ()) -> Diagnosis:
    """Diagnose a recording that is usable. `lacking`: effects taken out of the library, to test its refusals."""
    nominal, work = whole.nominal, Work(progress)
    replayer = replayer_of(nominal, whole.stretches) if nominal is not None and whole.stretches else None
    if nominal is not None and replayer is not None:
        work.expect_driven(nominal.n, sum(float(one.t_s[-1] - one.t_s[0]) for one in whole.stretches))
    behind = _behind(whole, work, lacking)
    dynamic = _dynamic(whole, replayer, work, behind, lacking)
    return concluded(whole, dynamic + told_beyond(behind, dynamic), work)


def concluded(
    whole: Read,
    searches: list[Search],
    work: Work | None = None,
    known: tuple[CellAnswer, ...] = (),
) -> Diagnosis:
    """The answer from the cells' searches. `known`: answers of as many searches, reused where a search is the same."""
    work = work or Work()
    work.conclude("weighing", 0.0)
    by_search = {id(one.search): one for one in known}
    answers = tuple(by_search.get(id(one)) or _answer(one, len(searches)) for one in searches)
    hypotheses = _hypotheses(answers)
    numbers = _numbers(answers, hypotheses)
    holes, frozen = (sum(one.count for one in whole.findings if one.code == code) for code in ("gap", "frozen"))
    still = stood_still(whole.stretches) and (whole.tables is None or whole.tables.static is None)
    word = verdict_of(answers, holes, still, whole.log_unused, frozen)
    told = maybe_none(word, answers, numbers, encoder_steps(whole.stretches))
    work.conclude("localising", 0.85)
    energy = energies([(one.cell, one.none.fit.residual) for one in searches])
    places = localise(whole, energy, nats_by_stage(answers))
    verdict = moves_by_itself(shared_gain(told, answers, numbers), speed_floors(places), whole.stretches)
    return Diagnosis(whole, verdict, answers, hypotheses, numbers, places)


def _dynamic(
    whole: Read, replayer: Replayer | None, work: Work, behind: list[Search], lacking: tuple[str, ...]
) -> list[Search]:
    """Link, controller, actuator in this order: what is found of one says how the next one's input really moved.

    What was found of the encoders from behind is no news to the actuators: they are replayed with it.
    """
    nominal = whole.nominal
    if nominal is None or replayer is None:
        return []
    base = _with_encoders(pack_under(nominal.baseline, nominal.n), behind)
    stretches = whole.stretches
    replayer = at_its_step(replayer, stretches, base)
    course, searches, unlike = base, [], ()
    unseen = (*lacking, *told_behind([one.cell for one in behind]))
    for stage in DRIVEN_STAGES:
        cells = fitting(with_known(stage_cells(stage, replayer, stretches, base, course), nominal), nominal)
        cells = without(cells, unseen)
        cells = [marked(replace(one, least_nats=_least(one, searches)), unlike) for one in cells]
        found = _searched(cells, work)
        unlike = (*unlike, *far_off(found))
        if stage == "link":
            found = [at_its_cycle(one, replayer, stretches, base) for one in found]
            course = next((unseen_wait(one, replayer, stretches, base) for one in found), course)
        if stage == "actuator" and found:
            found = told_who_sticks(_beside_each_other(found))
            coupled = coupled_cell(replayer, stretches, base, course)
            coupled = marked(with_known([coupled], nominal)[0], unlike) if coupled is not None else None
            found = with_coupling(found, coupled if DROOP not in lacking else None)
        for one in found:
            course = put(course, one.chosen.fit.hypothesis, one.chosen.fit.theta)
        if stage == "link":
            stretches = on_their_line(stretches, replayer, base, course)
        searches += found
    one_by_one, together = merged_cells(replayer, stretches, base, course)
    merged = [_worth_a_name(one) for one in _searched(without(fitting(one_by_one, nominal), unseen), work)]
    return searches + with_coupling(merged, together if DROOP not in lacking else None)


def _beside_each_other(found: list[Search]) -> list[Search]:
    """Joints share oil and booms: what is found on one may show a little on another, and is no second cause there."""
    gains = [one.chosen.total - one.none.total for one in found]
    out = []
    for k, one in enumerate(found):
        share = SHARED if one.cell.usual else SHARED_UNKNOWN
        least = share * max((gain for other, gain in enumerate(gains) if other != k), default=0.0)
        out.append(searched_again(one, least) if least > one.cell.least_nats and gains[k] > 0.0 else one)
    return out


def _worth_a_name(found: Search) -> Search:
    """A joint that was run without its valve commands: what explains a twentieth of what no name explains is no name.

    Why: between logged rows the whole loop runs on guesses; a gain of a thousandth makes such guesses a little better.
    """
    least = UNEXPLAINED_SHARE * 0.5 * (found.spread - 1.0) * found.cell.rows.count
    return searched_again(found, least) if found.chosen is not found.none and least > found.cell.least_nats else found


def _least(cell: Cell, before: list[Search]) -> float:
    """What a guessed input may be wrong by: 0.2 % of what the stages before it gained, but a tenth of that where other
    guesses change no more; 0 if every cycle is logged.
    """
    if not cell.coarse or not isinstance(cell.whitened, Replay):
        return 0.0
    feeding = [one for one in before if one.cell.joint in (None, cell.joint)]
    gained = sum(one.chosen.total - one.none.total for one in feeding)
    return min(FORM_SHARE * gained, max(cell.whitened.guessed_nats(), FORM_SHARE_LEAST * gained))


def _with_encoders(base: ParameterSets, behind: list[Search]) -> ParameterSets:
    """The baseline with the encoders' scale and waves as they were found from behind them."""
    for one in behind:
        for effect, theta in one.chosen.fit.by_effect:
            if effect.name in SEEN_BY_ENCODER:
                base = put(base, (effect,), theta)
    return base


def _behind(whole: Read, work: Work, lacking: tuple[str, ...]) -> list[Search]:
    """What was measured behind the encoders: points, marker corners."""
    if whole.nominal is None:
        return []
    base = pack_under(whole.nominal.baseline, whole.nominal.n)
    cells = behind_cells(whole, base, with_odometry=not whole.nominal.remainders)
    return _searched(without(fitting(cells, whole.nominal), lacking), work)


def _searched(cells: list[Cell], work: Work) -> list[Search]:
    out = []
    work.stage(cells)
    for cell in cells:
        work.begin(f"searching {cell.label}")
        out.append(searched(cell, work))
        work.end()
    return out


def _answer(found: Search, cells: int) -> CellAnswer:
    ranked = weighed(found)
    chosen = _named(found.cell, settled(found), ranked)
    gained = chosen.total - found.none.total
    shapes = left_shapes(found.cell, chosen.held_out, gained)
    sums = squares(found, chosen)
    return CellAnswer(
        search=found,
        chosen=chosen,
        weighed=_first(ranked, chosen),
        fired=(
            *remainder(found.cell, chosen, cells),
            *(refusing(found.cell, shapes, gained) or _instead(found, chosen)),
            *at_edge(found.cell, chosen),
            *gears(found.cell, chosen),
            *swinging(found.cell, chosen, shapes, gained),
        ),
        squares=sums,
        shrinks=shrinks(found, sums),
        limits=tuple(
            detection_limit(one, found.spread, found.cell.usual_nats(one.candidate, one.thetas[one.best]))
            for one in found.scans
        ),
        same=same_here(found, chosen),
        shapes=shapes,
    )


def _instead(found: Search, chosen: Score) -> tuple[Fired, ...]:
    if not chosen.fit.hypothesis:
        return ()
    return instead(found.cell, found.none.held_out, chosen.total - found.none.total)


def _named(cell: Cell, chosen: Score, ranked: tuple[Weighed, ...]) -> Score:
    """What is named: what passed the margin, or the likeliest part of it that fewer names cannot well be told from.

    Why: a margin asks one name whether it foretells; what else is there to name it for, and how often an undisturbed
    machine shows it, is weighed after that. What is named must be told three times rather than not; the others are
    leads, and stay in the 90 % set. Of 271 cases' names two of nine that were not there stood below that, one of 128
    that were. Of what drives the joints, without repeats and without a baseline: ten times; of 48 foreign
    recordings one name stood below that, and was not there.
    """
    odds = TOLD_ODDS_GUESSED if cell.noise_guessed else TOLD_ODDS
    while names := {effect.key for effect in chosen.fit.hypothesis}:
        fewer = sum(one.probability for one in ranked if len(one.score.fit.hypothesis) < len(names))
        if fewer * odds <= 1.0 - fewer:
            break
        chosen = next(one.score for one in ranked if {effect.key for effect in one.score.fit.hypothesis} < names)
    return chosen


def _first(all_of: tuple[Weighed, ...], chosen: Score) -> tuple[Weighed, ...]:
    """The chosen hypothesis first, none likelier: what passed the margin goes before what merely scored a little more.

    Where both have as many names, no margin stands between them: as likely as each other is what the two are then.
    """
    own = next(one for one in all_of if one.score is chosen)
    top = all_of[0]
    if own is top:
        return all_of
    share = 0.5 if len(top.score.fit.hypothesis) == len(chosen.fit.hypothesis) else CHOSEN_SHARE
    both = own.probability + top.probability
    most = share * both
    rest = [Weighed(one.score, min(one.probability, most)) for one in all_of if one is not own and one is not top]
    listed = (Weighed(chosen, most), Weighed(top.score, min((1.0 - share) * both, most)), *rest)
    total = sum(one.probability for one in listed)
    return tuple(
        sorted((replace(one, probability=one.probability / total) for one in listed), key=lambda one: -one.probability)
    )


def _hypotheses(answers: tuple[CellAnswer, ...]) -> tuple[Whole, ...]:
    """Over all cells; none where nothing could be replayed, since then "no effect" is no answer either."""
    return combined([one.weighed for one in answers]) if answers else ()


def _numbers(answers: tuple[CellAnswer, ...], hypotheses: tuple[Whole, ...]) -> dict[int, tuple[Interval, ...]]:
    """Limits of the numbers of every score that a reported hypothesis uses."""
    out: dict[int, tuple[Interval, ...]] = {}
    for hypothesis in hypotheses[:10]:
        for answer, score in zip(answers, hypothesis.scores, strict=True):
            if id(score) not in out:
                found = answer.search
                out[id(score)] = intervals(found.cell, score.fit, found.spread, score.total - found.none.total)
    return out
