"""Fit, score, margin, classes and refusal on a made-up cell with a residual that is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_cell import ASYMMETRY, COLUMNS, GAIN, LAG, T, made_up

from diagnosis.baseline.forward import forward
from diagnosis.diagnose import _answer
from diagnosis.errors import DiagnosisError
from diagnosis.refusal.remainder import Fired, at_edge, remainder
from diagnosis.search.candidates import candidates_of, named, put
from diagnosis.search.cell import Cell, blocks_of, folds_of
from diagnosis.search.fit import evaluated, fit, jacobian, neutral_fit
from diagnosis.search.limits import detection_limit, intervals
from diagnosis.search.scan import scan
from diagnosis.search.score import better, covariance, log_evidence, score
from diagnosis.search.search import search
from diagnosis.verdict.shrink import closed_share, shrinks, squares
from diagnosis.verdict.verdict import verdict_of
from diagnosis.verdict.weigh import Weighed, calibration, combined, same_here, weighed
from machine.effects.layout import ParameterSets, neutral_sets
from machine.remainder import usual_name


def test_a_fit_finds_the_sizes_of_a_linear_residual() -> None:
    cell = made_up((0.2, -0.1, 0.0), noise=0.0)
    pair = cell.candidates[:2]
    found = fit(cell, pair, np.array([0.05, 0.05]))
    assert found.theta == pytest.approx([0.2, -0.1], abs=1e-6)
    assert found.cost < 1e-6
    J = jacobian(cell, pair, found.theta, found.residual)
    assert pytest.approx(-40.0 * COLUMNS[:2].T, abs=1e-6) == J


def test_a_start_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(DiagnosisError, match="a start has 1 numbers"):
        fit(made_up((0.0, 0.0, 0.0)), named(("flow_gain_error", "valve_lag"), (1,)), np.zeros(1))


def test_a_fit_stays_inside_its_bounds_and_says_so() -> None:
    cell = made_up((0.0, 0.0, 0.9))
    found = fit(cell, cell.candidates[2:], np.array([0.1]))
    assert found.theta[0] == LAG.high
    assert found.at_bound == (True,)


@pytest.mark.parametrize(("truth", "word"), [(0.4, "effects"), (0.504, "outside")])
def test_a_name_that_fits_only_at_the_end_of_what_is_believed_is_not_told(truth: float, word: str) -> None:
    cell = made_up((0.0, 0.0, truth))
    answer = _answer(search(cell), 1)
    assert [one.name for one in answer.chosen.fit.hypothesis] == ["valve_lag"]
    verdict = verdict_of((answer,))
    assert verdict.word == word
    assert ("valve_lag is 0.5, the most that is believed of it" in verdict.why) == (word == "outside")


@pytest.mark.parametrize(("known_well", "word"), [(False, "effects"), (True, "undecided")])
def test_three_faults_at_once_on_a_machine_known_well_are_rather_one_that_has_no_name(
    known_well: bool, word: str
) -> None:
    cell = replace(made_up((0.3, 0.3, 0.3)), usual=(("peak", 0.0),) if known_well else ())
    answer = _answer(search(cell), 1)
    assert len(answer.chosen.fit.hypothesis) == 3
    verdict = verdict_of((answer,))
    assert verdict.word == word
    assert ("3 faults at once" in verdict.why) == known_well


@pytest.mark.parametrize(
    ("asymmetry", "known_well", "word"), [(0.4, True, "effects"), (-0.4, True, "undecided"), (-0.4, False, "effects")]
)
def test_two_names_that_undo_each_other_on_a_machine_known_well_are_rather_one_that_has_no_name(
    asymmetry: float, known_well: bool, word: str
) -> None:
    cell = replace(made_up((0.4, asymmetry, 0.0)), usual=(("peak", 0.0),) if known_well else ())
    answer = _answer(search(cell), 1)
    assert {one.name for one in answer.chosen.fit.hypothesis} == {"flow_gain_error", "valve_asymmetry"}
    verdict = verdict_of((answer,))
    assert verdict.word == word
    assert ("of each other: one cause" in verdict.why) == (word == "undecided")


@pytest.mark.parametrize(("asymmetry", "both"), [(0.2, True), (-0.2, False)])
def test_a_usual_state_holds_no_names_that_undo_each_other(asymmetry: float, both: bool) -> None:
    found = {one.name for one in forward(made_up((0.2, asymmetry, 0.0))).fit.hypothesis}
    assert found
    assert ({"flow_gain_error", "valve_asymmetry"} <= found) == both


def test_doubt_where_nothing_is_named_takes_no_name_back_but_doubt_of_the_name_does() -> None:
    named_one = _answer(search(made_up((0.3, 0.0, 0.0))), 1)
    quiet = _answer(search(made_up((0.0, 0.0, 0.0))), 1)
    assert not quiet.chosen.fit.hypothesis
    first = next(one for one in named_one.weighed if one.score is named_one.chosen)
    names = {effect.key for effect in named_one.chosen.fit.hypothesis}
    other = next(one for one in named_one.weighed if not names & {effect.key for effect in one.score.fit.hypothesis})
    doubtful = replace(quiet, weighed=(Weighed(quiet.chosen, 0.4), Weighed(other.score, 0.6)))
    assert verdict_of((named_one, doubtful, doubtful)).word == "effects"
    unsure = replace(named_one, weighed=(Weighed(first.score, 0.4), Weighed(other.score, 0.6)), same=())
    assert "0.4 among others" in verdict_of((unsure, quiet)).why
    assert "certain" not in verdict_of((unsure, quiet)).why
    beside = next(one for one in named_one.weighed if names < {effect.key for effect in one.score.fit.hypothesis})
    sure = replace(unsure, weighed=(Weighed(first.score, 0.4), Weighed(beside.score, 0.6)))
    assert verdict_of((sure, quiet)).word == "effects"  # whatever is beside it, the name is at work


@pytest.mark.parametrize(
    ("name", "left", "word"),
    [("stiction", 0.2, "effects"), ("stiction", 0.35, "undecided"), ("valve_lag", 0.2, "undecided")],
)
def test_a_joint_that_sticks_may_ring_after_its_jumps(
    name: str, left: float, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = _answer(search(made_up((0.0, 0.0, 0.2))), 1)
    (lag,) = found.chosen.fit.hypothesis
    chosen = replace(found.chosen, fit=replace(found.chosen.fit, hypothesis=(replace(lag, name=name),)))
    rings = Fired("autocorrelation", "actuator", 1, 0.2, 0.0, "goes on over 0.15 s")
    answer = replace(found, chosen=chosen, weighed=(Weighed(chosen, 1.0),), fired=(rings,))
    monkeypatch.setattr("diagnosis.verdict.verdict._left", lambda _one: left)
    assert verdict_of((answer,)).word == word


def test_a_limit_that_cuts_nothing_off_stands_at_no_end() -> None:
    (droop,) = named(("supply_droop",), ())
    cell = replace(made_up((0.0, 0.0, 0.0)), candidates=(droop,))
    none_cut = replace(neutral_fit(cell), hypothesis=(droop,), theta=np.array([droop.slots[0].high]), at_bound=(True,))
    assert droop.slots[0].neutral >= droop.slots[0].high - 0.1
    assert at_edge(cell, replace(score(cell, neutral_fit(cell)), fit=none_cut)) == ()


def test_limits_of_a_number_are_those_of_least_squares() -> None:
    cell = made_up((0.2, 0.0, 0.0))
    found = fit(cell, cell.candidates[:1], np.array([0.1]))
    sd = float(np.sqrt(covariance(found)[0, 0]))
    (one,) = intervals(cell, found, 1.0)
    assert one.high - one.low == pytest.approx(2.0 * 1.645 * sd, rel=0.15)
    assert one.low < 0.2 < one.high


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        ((0.0, 0.0, 0.0), set()),
        ((0.15, 0.0, 0.0), {"flow_gain_error"}),
        ((0.0, 0.0, 0.1), {"valve_lag"}),
        ((0.2, -0.15, 0.0), {"flow_gain_error", "valve_asymmetry"}),
    ],
)
def test_search_takes_what_passes_the_margin_and_no_more(truth: tuple[float, float, float], expected: set[str]) -> None:
    found = search(made_up(truth))
    assert {one.name for one in found.chosen.fit.hypothesis} == expected
    probabilities = [one.probability for one in weighed(found)]
    assert sum(probabilities) == pytest.approx(1.0)
    assert {one.name for one in weighed(found)[0].score.fit.hypothesis} == expected


def test_a_larger_model_alone_does_not_pass_the_margin() -> None:
    cell = made_up((0.0, 0.0, 0.0))
    none = score(cell, neutral_fit(cell))
    fuller = score(cell, fit(cell, cell.candidates, np.array([0.01, 0.01, 0.01])))
    assert fuller.fit.cost < none.fit.cost  # it fits better, and foretells no better
    assert not better(fuller, none, none)
    assert log_evidence(fuller.fit) < log_evidence(none.fit)


def test_blocks_judge_what_was_fitted_and_not_what_the_log_shows() -> None:
    cell = made_up((0.0, 0.0, 0.0))
    none = score(cell, neutral_fit(cell))
    found = score(cell, fit(cell, cell.candidates[:1], np.array([0.01])))
    once = replace(found, by_block=none.by_block + 40.0 * np.eye(1, len(none.by_block))[0])  # all of it in one block
    assert not better(once, none, none)
    shown = replace(once, fit=replace(once.fit, hypothesis=(replace(cell.candidates[0], read_off=True),)))
    assert better(shown, none, none)
    few = replace(shown, by_block=none.by_block + 4.0 * np.eye(1, len(none.by_block))[0])
    assert not better(few, none, none)


def test_a_name_that_touches_few_blocks_has_to_gain_in_each() -> None:
    cell = made_up((0.0, 0.0, 0.0))
    none = score(cell, neutral_fit(cell))
    found = score(cell, fit(cell, cell.candidates[:1], np.array([0.01])))
    uneven = np.zeros(len(none.by_block))
    uneven[:3] = (3.0, 6.0, 40.0)  # of three fast moves the fastest is cut most
    assert better(replace(found, by_block=none.by_block + uneven), none, none)
    assert not better(replace(found, by_block=none.by_block + np.where(uneven == 3.0, -3.0, uneven)), none, none)
    everywhere = uneven + np.where(uneven == 0.0, 0.01, 0.0)
    assert not better(replace(found, by_block=none.by_block + everywhere), none, none)


def test_effects_of_one_direction_are_one_class() -> None:
    cell = made_up((0.2, 0.0, 0.0))
    twins = replace(cell, whitened=lambda sets: cell.whitened(_both_into_gain(sets)))
    found = search(twins)
    classes = same_here(found, found.chosen)
    assert {key[0] for key in classes[0]} >= {"flow_gain_error", "valve_asymmetry"}


def test_what_points_the_same_way_is_told_apart_where_it_is_large() -> None:
    small, large = (same_here(found, found.chosen) for found in (search(_nearly_alike(g)) for g in (0.03, 0.2)))
    assert {key[0] for key in small[0]} >= {"flow_gain_error", "valve_asymmetry"}
    assert not large


def _nearly_alike(gain: float) -> Cell:
    cell = made_up((gain, 0.0, 0.0))
    return replace(cell, whitened=lambda sets: cell.whitened(_both_into_gain(sets, 0.2)))


def _both_into_gain(sets: ParameterSets, apart: float = 0.0) -> ParameterSets:
    joint = sets.joint.copy()
    joint[..., GAIN.column] += (1.0 - apart) * joint[..., ASYMMETRY.column]
    joint[..., ASYMMETRY.column] *= apart
    return ParameterSets(joint, sets.machine)


def test_a_detection_limit_is_where_the_change_is_eight_and_a_half_floors() -> None:
    cell = made_up((0.0, 0.0, 0.0))
    limit = detection_limit(scan(cell, cell.candidates[0], neutral_fit(cell)), 1.0)
    assert limit.size is not None
    change = evaluated(cell, cell.candidates[:1], np.array([[limit.size]]))[0] - cell.whitened(cell.base)[0]
    assert float(change @ change) == pytest.approx(72.7, rel=0.02)


def test_a_remainder_fires_with_its_lead_and_noise_does_not() -> None:
    cell = made_up((0.0, 0.0, 0.0))
    none = score(cell, neutral_fit(cell))
    assert remainder(cell, none, 10) == ()
    left = replace(none, held_out=none.held_out + 1.2 * np.sin(1.9 * T))
    fired = remainder(cell, left, 10)
    assert "goes with command" in [one.lead for one in fired]
    assert any(one.test == "peak" and "time" in one.lead for one in fired)


def test_closed_share_is_never_clipped_and_none_without_a_gap() -> None:
    count = np.full(20, 50.0)
    worse = closed_share(3.0 * count, 5.0 * count, count, 1000, 0)
    assert worse[0] == pytest.approx(-1.0)
    assert closed_share(count, 0.9 * count, count, 1000, 0) == (None, None, None)
    whole = closed_share(9.0 * count, count, count, 1000, 0)
    assert whole == pytest.approx((1.0, 1.0, 1.0))


def test_a_gap_below_what_noise_is_known_by_is_held_against_what_the_catalogue_foretells() -> None:
    found = search(made_up((0.014, 0.0, 0.0)))  # |s|^2 = 94 beside 600 rows of noise
    assert [one.name for one in found.chosen.fit.hypothesis] == ["flow_gain_error"]
    (whole,) = shrinks(found, squares(found, found.chosen))
    assert whole.floor_by == "catalogue"
    assert whole.closed_frac == pytest.approx(1.0, abs=0.2)
    assert whole.low < 1.0 < whole.high
    change = found.chosen.held_out - found.none.held_out
    half = replace(found.chosen, held_out=found.none.held_out + 0.5 * change)
    (part,) = shrinks(found, squares(found, half))
    assert part.closed_frac == pytest.approx(0.75, abs=0.2)
    assert part.closed_frac < whole.closed_frac
    nothing = search(made_up((0.0, 0.0, 0.0)))
    assert shrinks(nothing, squares(nothing, nothing.none))[0].closed_frac is None


def test_blocks_and_folds() -> None:
    blocks, number = blocks_of([400, 200])
    assert number >= 12
    assert (np.diff(blocks) >= 0).all()
    assert len(np.unique(blocks)) == number
    assert set(blocks[:400]).isdisjoint(blocks[400:])
    fold, same = folds_of(["steps"], [600], blocks)
    assert same
    assert set(fold) == {0, 1, 2}


def test_cells_combine_as_independent_parts() -> None:
    one, two = (weighed(search(made_up(truth))) for truth in ((0.15, 0.0, 0.0), (0.0, 0.0, 0.0)))
    whole = combined([one, two])
    assert whole[0].probability == pytest.approx(one[0].probability * two[0].probability)
    assert [part.probability for part in whole] == sorted((part.probability for part in whole), reverse=True)


def test_every_candidate_has_starts_inside_bounds_and_off_neutral() -> None:
    for stage in ("time", "link", "controller", "actuator", "joint", "structure", "camera"):
        for one in candidates_of(stage, (1, 2), True):
            starts = one.starts()
            low, high = np.array([s.low for s in one.slots]), np.array([s.highest for s in one.slots])
            assert (starts >= low - 1e-12).all(), one.key
            assert (starts <= high + 1e-12).all(), one.key
            changed = put(neutral_sets(2), (one,), starts[:1])
            neutral = neutral_sets(2)
            moved = not np.array_equal(changed.joint, neutral.joint) or not np.array_equal(
                changed.machine, neutral.machine
            )
            assert moved, one.key


def test_a_baseline_is_kept_under_a_hypothesis() -> None:
    base = neutral_sets(1)
    base.put(GAIN, 0.1)
    (gain,) = named(("flow_gain_error",), (1,))
    assert put(base, (gain,), np.array([[0.2]])).get(GAIN) == pytest.approx(0.3)


def test_the_frozen_numbers_are_read() -> None:
    numbers = calibration()
    assert numbers.temperature_without_floor > numbers.temperature > 0.0
    assert dict(numbers.outside_probability)["outside"] > 0.5


def test_a_name_that_gains_on_the_undisturbed_machine_has_to_gain_that_much_more() -> None:
    cell = made_up((0.02, 0.0, 0.0))
    found = search(cell)
    assert [one.name for one in found.chosen.fit.hypothesis] == ["flow_gain_error"]
    gain = found.chosen.total - found.none.total
    held = search(replace(cell, usual_names=((usual_name("flow_gain_error"), gain),)))
    assert "flow_gain_error" not in [one.name for one in held.chosen.fit.hypothesis]
    elsewhere = search(replace(cell, usual_names=((usual_name("valve_lag"), gain),)))
    assert [one.name for one in elsewhere.chosen.fit.hypothesis] == ["flow_gain_error"]
    several = tuple((usual_name(name), gain) for name in ("valve_lag", "valve_deadband", "stiction"))
    anywhere = search(replace(cell, usual_names=several))  # three that do: a fourth may
    assert "flow_gain_error" not in [one.name for one in anywhere.chosen.fit.hypothesis]


def test_noise_above_what_was_estimated_is_no_none() -> None:
    """Where nothing was measured twice, a residual that no name foretells may be noise or a gap: nobody can tell."""
    loud, quiet = (
        verdict_of((_answer(search(replace(made_up((0.0, 0.0, 0.0), noise=noise), floor_known=False)), 1),))
        for noise in (1.6, 1.1)
    )
    assert loud.word == "undecided"
    assert "repeat a motion or a pose" in loud.why
    assert quiet.word == "none"
