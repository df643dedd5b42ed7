"""What the verdict makes of a trace beside a clear finding, and of names of which only some are certain."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_cell import made_up

from diagnosis.baseline.baseline import Baseline
from diagnosis.diagnose import _answer
from diagnosis.refusal.remainder import Fired
from diagnosis.refusal.shapes import TEST
from diagnosis.search.candidates import named
from diagnosis.search.limits import Interval
from diagnosis.search.search import search
from diagnosis.verdict.cell_answer import CellAnswer
from diagnosis.verdict.maybe_none import maybe_none
from diagnosis.verdict.verdict import Verdict, verdict_of
from diagnosis.verdict.weigh import Weighed
from longreach.fit_baseline import told
from machine.remainder import USUAL_ENERGY

FEW = (("peak", 0.0),)
MANY = (("peak", 0.0), (USUAL_ENERGY, 1.0))


@pytest.fixture(scope="module")
def clear() -> CellAnswer:
    """A structure in which an effect of some 40 000 nats is named."""
    return _answer(search(replace(made_up((0.4, 0.0, 0.0)), stage="structure")), 1)


@pytest.mark.parametrize(
    ("known", "nats", "usual", "word"),
    [
        (False, 20.0, (), "effects"),
        (False, 400.0, (), "outside"),
        (True, 20.0, (), "outside"),
        (False, 20.0, (("peak", 0.0),), "outside"),
    ],
)
def test_a_trace_where_the_noise_was_guessed_takes_no_clear_finding_back(
    clear: CellAnswer, known: bool, nats: float, usual: tuple[tuple[str, float], ...], word: str
) -> None:
    """A thousandth of what the name explains; not where repeats or a baseline say that it does not belong there."""
    quiet = _answer(search(replace(made_up((0.0, 0.0, 0.0)), floor_known=known, usual=usual)), 1)
    swings = Fired(TEST, "actuator", 1, nats, 0.0, "goes with time")
    verdict = verdict_of((clear, replace(quiet, fired=(swings,))))
    assert verdict.word == word, verdict.why
    assert "goes with time" in verdict.why
    assert verdict.why.endswith("a trace") == (word == "effects")


def test_the_same_alone_is_a_gap() -> None:
    quiet = _answer(search(replace(made_up((0.0, 0.0, 0.0)), floor_known=False)), 1)
    swings = Fired(TEST, "actuator", 1, 20.0, 0.0, "goes with time")
    assert verdict_of((replace(quiet, fired=(swings,)),)).word == "outside"


def test_names_that_nearly_every_hypothesis_holds_are_told_beside_doubtful_ones() -> None:
    found = _answer(search(made_up((0.3, 0.3, 0.0))), 1)
    keys = {effect.key for effect in found.chosen.fit.hypothesis}
    assert keys == {("flow_gain_error", 1), ("valve_asymmetry", 1)}
    both = next(one for one in found.weighed if {key.key for key in one.score.fit.hypothesis} == keys)
    gain = next(one for one in found.weighed if [key.key[0] for key in one.score.fit.hypothesis] == ["flow_gain_error"])
    unsure = replace(found, weighed=(Weighed(both.score, 0.4), Weighed(gain.score, 0.6)), same=())
    verdict = verdict_of((unsure,))
    assert verdict.word == "undecided"
    assert "probability of 0.4 among others; of them certain: flow_gain_error 1 (1)" in verdict.why


@pytest.mark.parametrize(
    ("usual", "share", "high", "by", "word", "said"),
    [
        ((), 0.26, 0.7, "noise", "effects", ""),
        ((), 0.26, 0.4, "noise", "undecided", "40 % of the gap at the most"),
        ((), 0.06, 1.0, "catalogue", "undecided", "6 % of the gap: more of it is something else"),
        ((), 0.6, 1.0, "catalogue", "effects", ""),
        ((), None, None, "noise", "undecided", "nothing stands out of what repeats differ by"),
        (MANY, None, None, "noise", "effects", ""),
        (
            FEW,
            0.26,
            0.7,
            "noise",
            "undecided",
            "26 % of the gap, and the machine's usual state is known of too few days",
        ),
        (MANY, 0.04, 0.7, "noise", "undecided", "4 % of the gap: more of it is something else"),
        (MANY, 0.08, 0.7, "noise", "effects", ""),  # decision 32
        (MANY, -0.07, 0.1, "noise", "undecided", "-7 % of the gap"),
    ],
)
def test_names_that_close_little_of_a_gap_are_no_answer(
    clear: CellAnswer,
    usual: tuple[tuple[str, float], ...],
    share: float | None,
    high: float | None,
    by: str,
    word: str,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An upper limit clears a name only where nothing is allowed for as usual: there what is left would refuse it."""
    monkeypatch.setattr(
        "diagnosis.verdict.closed.closing",
        lambda _squares: (1.0, 0.9, 0.1, (share, None if share is None else -0.1, high), by),
    )
    cell = replace(clear.search.cell, usual=usual, coarse=True)  # its input between rows is a guess
    verdict = verdict_of((replace(clear, search=replace(clear.search, cell=cell)),))
    assert verdict.word == word, verdict.why
    assert said in verdict.why
    if share is None:
        even = replace(clear, search=replace(clear.search, cell=replace(cell, coarse=False)))
        assert verdict_of((even,)).word == "effects"


def test_a_baseline_of_few_says_how_many_are_enough() -> None:
    """With thirteen recordings three are fitted and ten judge; a third of eleven would leave eight."""
    few, many = (told(Baseline((), (), (), ()), fitted, count) for fitted, count in ((1, 3), (3, 13)))
    assert few.splitlines()[0] == "few: with 13 recordings it can also refuse what it has no name for"
    assert "few:" not in many


@pytest.mark.parametrize(
    ("known", "tail_s", "size", "word"),
    [(False, 9.0, 0.0, "undecided"), (True, 9.0, 0.0, "outside"), (False, 15.0, 0.0, "outside"), (False, 9.0, 0.5, "")],
    ids=["short", "repeated", "long", "large"],
)
def test_a_short_record_without_repeats_tells_noise_that_goes_on_from_no_fault(known, tail_s, size, word) -> None:
    """Some seconds of a disturbance look like anything; a gap that stands clear of it may be told all the same."""
    cell = made_up((size, 0.0, 0.0))
    short = replace(cell, floor_known=known, t_s=np.linspace(0.0, tail_s, len(cell.t_s)))
    fired = Fired("autocorrelation", "actuator", 1, 0.7, 0.0, "goes on over 0.05 s")
    verdict = verdict_of((replace(_answer(search(short), 1), fired=(fired,)),))
    assert word in verdict.word
    assert ("s without repeats" in verdict.why) == (word == "undecided")


@pytest.mark.parametrize(
    ("low", "high", "word"), [(0.2, 0.4, "effects"), (0.0, 0.6, "undecided"), (0.02, 0.5, "undecided")]
)
def test_a_name_whose_size_may_be_none_is_not_told(low: float, high: float, word: str) -> None:
    found = _answer(search(made_up((0.3, 0.0, 0.0))), 1)
    before = verdict_of((found,))
    assert before.word == "effects"
    after = maybe_none(before, (found,), {id(found.chosen): (Interval(0.3, low, high),)}, {1: 0.5})
    assert after.word == word
    assert ("flow_gain_error on joint 1" in after.why) == (word == "undecided")
    mirrored = maybe_none(before, (found,), {id(found.chosen): (Interval(-0.3, -high, -low),)}, {})
    assert mirrored.word == word


@pytest.mark.parametrize(
    ("stage", "usual", "word"),
    [("link", True, "effects"), ("link", False, "undecided"), ("actuator", True, "undecided")],
)
def test_a_wait_that_no_undisturbed_day_showed_is_a_delay_however_short(stage: str, usual: bool, word: str) -> None:
    found = _answer(search(made_up((0.3, 0.0, 0.0))), 1)
    known = ((USUAL_ENERGY, 1.0),) if usual else ()
    search_there = replace(found.search, cell=replace(found.search.cell, stage=stage, usual=known))
    found = replace(found, search=search_there)
    sizes = {id(found.chosen): (Interval(0.3, 0.0, 0.6),)}
    assert maybe_none(Verdict("effects", "as found"), (found,), sizes, {}).word == word


@pytest.mark.parametrize(("step_rad", "word"), [(0.0, "effects"), (2e-3, "effects"), (5e-3, "undecided")])
def test_a_play_within_one_step_of_its_encoder_is_not_told(step_rad: float, word: str) -> None:
    (play,) = named(("backlash",), (1,))
    found = _answer(search(made_up((0.3, 0.0, 0.0))), 1)
    chosen = replace(found.chosen, fit=replace(found.chosen.fit, hypothesis=(play,)))
    found = replace(found, chosen=chosen)
    sizes = {id(chosen): (Interval(4e-3, 3.9e-3, 4.1e-3),)}
    after = maybe_none(Verdict("effects", "as found"), (found,), sizes, {1: step_rad})
    assert after.word == word
    assert ("less than one step of the encoder" in after.why) == (word == "undecided")
