"""None, effects, outside or undecided: what the cells' answers come to."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from diagnosis.cells.behind import guessed_scatter_m, measured_scatter_m, measurement_of
from diagnosis.families.behind import IN_TURN
from diagnosis.families.driven import SINCE
from diagnosis.refusal.remainder import CORRELATION, EDGE, ENERGY_MIN, Fired
from diagnosis.refusal.shapes import SINGLE_MOMENTS, Shape
from diagnosis.refusal.shapes import TEST as SHAPE
from diagnosis.search.cell import DRIVEN_STAGES, Cell
from diagnosis.search.score import FORM_SHARE_STUCK, STICKS
from diagnosis.search.undoing import Undoing, undoing
from diagnosis.verdict.certain import certain_in_words, probability_of_names
from diagnosis.verdict.closed import closes_little, closing_little
from diagnosis.verdict.late_log import late_log
from diagnosis.verdict.shrink import by_noise, together

if TYPE_CHECKING:
    from diagnosis.verdict.cell_answer import CellAnswer

Word = Literal["none", "effects", "outside", "undecided"]
DOUBTED = ("outside", "undecided")  # verdicts beside which no hypothesis is a finding
LEFT_SMALL = 0.02  # share of the gap: a remainder below it does not take back a name
TRACE = 0.005  # share of what the names explain: what fired in a cell of guessed noise without one
LEFT_STUCK = FORM_SHARE_STUCK  # the same where a joint sticks: what rings after each of its jumps has no model
LEFT_LARGE = 0.5  # share of the gap: a remainder above it says that no name fits
HOLES_MANY = 10  # a cable pulled once is no fault of the log; samples that go missing all the time are
UNDONE_IN_A_CROWD = 0.8  # of three names of one joint that stood for one bent coder two undid 0.90 and 0.96
CROWD = 3  # names at once on a machine whose usual state is known: one cause that the catalogue lacks is likelier
WITH_TIME, DRIFT_NATS = "time", 25.0  # twice what is told as a lead: of 40 sound recordings none showed it
CHANGED_NATS = 30.0  # of a joint: of 150 recordings of machines that stayed as they were none showed 15
COURSE_NATS = 45.0  # of one: of 30 sound foreign recordings without a baseline none showed 34; a gear's ripple, 62
LOUD = 4.0  # energy of what is left over a noise that was only estimated
BRIEF_S, BRIEF_ENERGY = 12.0, 4.0  # without repeats: sound machines of 5 to 11 s showed up to 2.1, and names of it
SCATTER_TOLD_M = 2e-3  # more than most trackers: it may hide a fault where no pose was measured twice
SCATTER_MAX_M = 0.02  # of measured points: no tracker or camera is that bad
SURE = 0.5  # probability of the names, with their equivalents


@dataclass(frozen=True, slots=True)
class Verdict:
    """The word, and why, in one sentence a person can act on."""

    word: Word
    why: str


def verdict_of(
    answers: tuple[CellAnswer, ...],
    holes: int = 0,
    stood_still: bool = False,
    log_unused: bool = False,
    frozen: int = 0,
) -> Verdict:
    """The verdict over all cells. `holes`: places where the log lacks rows; `stood_still`: all is of one posture;
    `log_unused`: there is a PLC's log, and nothing of it could be judged; `frozen`: places where it repeats old values.

    Model: a remainder that tests find takes back a name: a wrong effect can close most of a foreign gap. It is
           "outside" where it is most of the gap, or nothing was named; else "undecided", unless below 2 % of the gap
           (30 % where a joint sticks).
    """
    if not answers:
        return Verdict("undecided", "no stage could be replayed")
    gained = sum(_gained_nats(one) for one in answers)
    traces = [one for one in answers if one.fired and _is_trace(one, gained)]
    echoes = [one for one in answers if _may_answer_noise(one)]
    speaking = [one for one in answers if one.fired and one not in traces and one not in echoes]
    outside = [one for one in speaking if _left(one) > LEFT_LARGE]
    partly = [one for one in speaking if _allowed(one) < _left(one) <= LEFT_LARGE]
    small = [one for one in speaking if one not in outside and one not in partly and _leading(one).lead]
    named = [effect for one in answers for effect in one.chosen.fit.hypothesis]
    late = late_log(answers)
    if late is not None and late.seen_by_clock:
        return Verdict("outside", late.words)
    one_cause = f"; {late.words}" if late is not None else ""
    scattered = max((guessed_scatter_m(one.search.cell) for one in answers), default=0.0)
    if scattered > SCATTER_MAX_M and (outside or partly or not named):
        text = f"the points scatter by {1e3 * scattered:.3g} mm about every model of this arm: that is no noise"
        remedy = "check the points' joint, frame and unit, order and sign of the joints, and the arm's convention"
        return Verdict("undecided", f"{text}; {remedy}, and measure some poses twice")
    again = max((measured_scatter_m(one.search.cell) for one in answers), default=0.0)
    if again > SCATTER_MAX_M:
        text = f"the same point of a pose differs by {1e3 * again:.3g} mm where it was measured again: that is no noise"
        return Verdict("undecided", f"{text}; give every reflector its own name, and every pose its own index")
    telling = [one for one in answers if one.fired or one.chosen.fit.hypothesis]
    if telling and all(_brief(one) for one in telling):
        cell = telling[0].search.cell
        text = f"{cell.label}: {_duration_s(cell):.2g} s without repeats do not tell noise that goes on from a fault"
        return Verdict("undecided", f"{text}; record {BRIEF_S:g} s or more, a minute is better, or repeat the motion")
    if outside:
        one = outside[0]
        return Verdict("outside", f"{_where(one)}: a gap that nothing in the catalogue explains{_lead(one)}")
    if partly:
        one = partly[0]
        text = f"{_where(one)}: the best names leave {100 * _left(one):.3g} % of the gap{_lead(one)}"
        return Verdict("undecided", text + one_cause)
    if stood_still:
        text = "no joint moved, and at one posture a mount, a lens, a zero and a print look alike"
        return Verdict("undecided", f"{text}; record a motion of all joints, or a whole job from look to accept")
    if frozen >= HOLES_MANY:
        text = f"the log goes on with old encoder values in {frozen} places while the machine moves"
        return Verdict("undecided", f"{text}: look at the logger first")
    if not named and holes >= HOLES_MANY:
        text = f"nothing above the noise floor in what was logged, but rows are missing in {holes} places"
        return Verdict("undecided", f"{text}: look at the logger first")
    if not named and log_unused:
        text = "nothing above the noise floor in what could be judged, but nothing of the PLC's log could be"
        return Verdict("undecided", f"{text}: mend what is said of it first")
    unclear = [one for one in answers if _above_a_guess(one)]
    if not named and unclear:
        cell = unclear[0].search.cell
        text = f"{cell.label}: {_over_noise(unclear[0])}, and no name foretells it"
        return Verdict("undecided", f"{text}; repeat a motion or a pose, so that the noise is known")
    drifting = [(one, shape) for one in answers for shape in one.shapes if _drifts(one, shape)]
    if not named and drifting:
        return Verdict("undecided", _drifting_in_words(*drifting[0]))
    if not named and echoes:
        one = echoes[0]
        text = f"{_where(one)}: what is left {_leading(one).lead}, as a command that answers the noise does in a loop"
        return Verdict("undecided", f"{text}; repeat a motion: what a fault does is the same in every repeat")
    if not named and scattered > SCATTER_TOLD_M:
        text = f"the points scatter by {1e3 * scattered:.3g} mm about every model of this arm"
        return Verdict("undecided", f"{text}: measure some poses twice, to tell that from a fault")
    if not named:
        return Verdict("none", "nothing above the noise floor")
    loud = [one for one in unclear if one.chosen.fit.hypothesis and _energy(one) > LOUD]
    if loud:
        one = loud[0]
        text = f"{one.search.cell.label}: the best names leave {_over_noise(one)}"
        return Verdict("undecided", f"{text}: more is wrong than they say")
    little = [one for one in answers if closes_little(one)]
    if little:
        return Verdict("undecided", closing_little(little[0]))
    if len(named) >= CROWD and all(one.search.cell.known_well for one in answers):
        names = ", ".join(dict.fromkeys(effect.name for effect in named))
        return Verdict("undecided", f"{len(named)} faults at once ({names}): look for one cause of all of them first")
    undone = next((pair for one in answers if (pair := _undone(one)) is not None), None)
    if undone is not None:
        text = f"{undone.names[0]} and {undone.names[1]} undo {100.0 * undone.share:.2g} % of each other"
        return Verdict("undecided", f"{text}: one cause that the catalogue lacks is likelier than both at once")
    sure = probability_of_names(answers)
    if sure < SURE:
        text = f"the names found have a probability of {sure:.2g} among others{certain_in_words(answers)}"
        left = f"; what is left is {_over_noise(unclear[0])}: repeats would tell it" if unclear else ""
        return Verdict("undecided", text + left)
    beside = "".join(f"; beside it {_where(one)} {_leading(one).lead}, a trace" for one in [*traces, *small][:1])
    return Verdict(
        "effects", f"{'catalogue effects explain the gap' if not unclear else _partly(unclear[0])}{beside}{one_cause}"
    )


def _undone(one: CellAnswer) -> Undoing | None:
    """Two names that undo much of each other; where nobody knows the machine's usual state, nearly all, and in a crowd
    of one joint's names.
    """
    pair = undoing(one.search.cell, one.chosen.fit, one.search.none.fit.residual)
    if pair is None or one.search.cell.known_well:
        return pair
    by_joint = Counter(effect.joint for effect in one.chosen.fit.hypothesis if effect.joint is not None)
    crowd = max(by_joint.values(), default=0) >= CROWD
    return pair if crowd and pair.share > UNDONE_IN_A_CROWD else None


def _gained_nats(one: CellAnswer) -> float:
    """What a cell's names explain."""
    return 0.5 * float(sum((of.before - of.after).sum() for of in one.squares)) if one.chosen.fit.hypothesis else 0.0


def _is_trace(one: CellAnswer, gained_nats: float) -> bool:
    """Whether what fired in a driven cell is next to nothing beside what the names elsewhere explain.

    Why: where the noise is what no mixture explains, something swings somewhere now and then: a clear
         finding of the tracker was taken back for 44 nats of an actuator. With repeats or a baseline it would count.
    """
    cell = one.search.cell
    if not cell.noise_guessed or one.chosen.fit.hypothesis:
        return False
    whole = 0.5 * float(sum(of.before.sum() for of in one.squares))
    fired = max(own.size if own.test == SHAPE else own.share * whole for own in one.fired)
    return fired < TRACE * gained_nats


def _brief(one: CellAnswer) -> bool:
    """Whether a driven cell of guessed noise is too short for a gap that stands out of it as little as this."""
    cell = one.search.cell
    if not cell.noise_guessed:
        return False
    return _duration_s(cell) < BRIEF_S and float(np.mean(one.search.none.held_out**2)) < BRIEF_ENERGY


def _may_answer_noise(one: CellAnswer) -> bool:
    """Whether all that speaks of a driven cell is what the loop's answer to its own noise foretells of that noise, and
    no repeats tell; what is left has the size that the noise was guessed to have.
    """
    cell = one.search.cell
    if not cell.noise_guessed or one.chosen.fit.hypothesis:
        return False
    small = _energy(one) < 1.0 + ENERGY_MIN
    return small and bool(one.fired) and all(fired.test == CORRELATION for fired in one.fired)


def _duration_s(cell: Cell) -> float:
    """How long a cell's joints were looked at, rows times their distance in time."""
    times = np.unique(cell.t_s)
    rows = cell.rows.count / max(1, len(np.unique(cell.rows.channel)))
    return rows * float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def _above_a_guess(one: CellAnswer) -> bool:
    """Whether more is left than the noise, where that was never measured: neither a gap nor none can be told."""
    return not one.search.cell.floor_known and _energy(one) > 1.0 + ENERGY_MIN


def _partly(one: CellAnswer) -> str:
    """What the names explain where the noise was never measured."""
    if not one.chosen.fit.hypothesis:
        text = f"catalogue effects explain what they are told of, but none of {one.search.cell.label}"
        return f"{text}, which shows {_over_noise(one)}: repeats would tell it"
    closed, _, _ = by_noise(together(one.squares))
    share = "" if closed is None else f" {100 * closed:.3g} % of"
    return f"catalogue effects explain{share} the gap; what is left is {_over_noise(one)}: repeats would tell it"


def _over_noise(one: CellAnswer) -> str:
    return f"{_two_digits(_energy(one))} times the noise that was estimated"


def _two_digits(value: float) -> str:
    """310, not 3.1e+02."""
    return f"{float(f'{value:.2g}'):,.12g}".replace(",", " ")


def _drifts(one: CellAnswer, shape: Shape) -> bool:
    """Whether what was measured behind the encoders moved with time, or what drives a joint changed from the start on
    or has a course without a name, where no baseline says that it always does.
    """
    if shape.stage in DRIVEN_STAGES:
        least = CHANGED_NATS if shape.goes_with == SINCE else COURSE_NATS
        return shape.goes_with != SINGLE_MOMENTS and shape.nats > least and not one.search.cell.known_well
    behind = shape.goes_with in (WITH_TIME, IN_TURN)
    parts = one.search.cell.parts or (one.search.cell,)
    alike = max((part.spread_least for part in parts if measurement_of(part) == shape.measurement), default=1.0)
    return behind and shape.nats > alike * DRIFT_NATS and not one.search.cell.known_well


def _drifting_in_words(one: CellAnswer, shape: Shape) -> str:
    if shape.stage in DRIVEN_STAGES:
        where = shape.stage if shape.joint is None else f"{shape.stage} {shape.joint}"
        why = "something changed while it was recorded" if shape.goes_with == SINCE else "nothing in the catalogue does"
        return f"{where}: what is left goes with {shape.goes_with}; {why}"
    text = f"{one.search.cell.label}: what is left of the {shape.measurement} points goes with {shape.goes_with}"
    return f"{text}; something moved that should not: a frame, a mount, a marker"


def _energy(one: CellAnswer) -> float:
    """Of what is left, in units of what is believed as floor: below that no guess of the noise means anything."""
    return float(np.mean(one.chosen.held_out**2))


def _allowed(one: CellAnswer) -> float:
    return LEFT_STUCK if any(effect.name == STICKS for effect in one.chosen.fit.hypothesis) else LEFT_SMALL


def _left(one: CellAnswer) -> float:
    """Share of the gap that is left, or of all its nats that a shape foretells.

    All of it where nothing was named, or only what nobody would believe.
    """
    if not one.chosen.fit.hypothesis or any(fired.test == EDGE for fired in one.fired):
        return 1.0
    closed, _, _ = by_noise(together(one.squares))  # the catalogue knows of no gap outside it
    shaped = max((fired.share for fired in one.fired if fired.test == SHAPE), default=0.0)
    return 1.0 if closed is None else max(1.0 - closed, shaped)


def _where(one: CellAnswer) -> str:
    """Stage and joint of what fired: a joined cell holds more than one stage."""
    first = _leading(one)
    return first.stage if first.joint is None else f"{first.stage} {first.joint}"


def _lead(one: CellAnswer) -> str:
    first = _leading(one)
    return f"; the remainder {first.lead}" if first.lead else ""


def _leading(one: CellAnswer) -> Fired:
    """The first test that says what the remainder goes with, else the first of all."""
    return next((fired for fired in one.fired if fired.lead), one.fired[0])
