"""The words of the budget: a row of the verdict's table each, and a stage judged by itself."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from diagnosis.verdict import BudgetColumn, EffectLine, StageLine, shows_a_gap, stage_verdict, usual_level, verdict_of
from machine.remainder import Remainder


def line_of(probability: float) -> EffectLine:
    return EffectLine(cast(Any, None), "stands", 1.0, 0.9, 1.1, 1.0, 1.0, probability)


def column_of(before_mm: float, after_mm: float) -> BudgetColumn:
    return BudgetColumn("stands", before_mm, after_mm, 0.0, True)


def verdict(
    probabilities: tuple[float, ...], before_mm: float, after_mm: float, gap: bool, known: bool, fits: int = 1
) -> str:
    """The word for these effects, miss, remainder; a tracker measured poses at rest."""
    whole = SimpleNamespace(stretches=(), tables=SimpleNamespace(static=object()))
    confirmed = any(probability >= 0.9 for probability in probabilities)
    word = stage_verdict(before_mm, after_mm, confirmed, small=0.5)
    assert (word == "unexplained") == (gap and not confirmed)
    stage = StageLine("structure", None, word, before_mm, after_mm, "")
    fit = SimpleNamespace(cell=SimpleNamespace(floor_known=known))
    given = (tuple(map(line_of, probabilities)), (column_of(before_mm, after_mm),), (stage,), (fit,) * fits)
    return verdict_of(cast(Any, whole), *cast(Any, given), ())[0]


@pytest.mark.parametrize(
    ("probabilities", "before_mm", "after_mm", "gap", "known", "word"),
    [
        ((0.95, 0.3), 10.0, 3.0, False, True, "effects"),  # 91 % of the squared miss
        ((0.95,), 10.0, 3.3, True, True, "partly"),  # 89 %
        ((0.95,), 10.0, 9.9, True, False, "partly"),
        ((0.89,), 10.0, 1.0, True, True, "undecided"),  # likely, not confirmed
        ((0.4,), 10.0, 10.0, True, True, "outside"),
        ((0.4,), 10.0, 10.0, True, False, "undecided"),  # it may be noise that was never measured
        ((0.4,), 0.1, 0.1, False, True, "none"),
        ((), 0.1, 0.1, False, True, "none"),
        ((), 0.1, 0.1, False, False, "undecided"),
    ],
)
def test_the_first_row_of_the_table_that_holds(
    probabilities: tuple[float, ...], before_mm: float, after_mm: float, gap: bool, known: bool, word: str
) -> None:
    assert verdict(probabilities, before_mm, after_mm, gap, known) == word


def test_without_any_part_that_could_be_fitted_nothing_is_decided() -> None:
    assert verdict((), 0.0, 0.0, False, True, fits=0) == "undecided"


@pytest.mark.parametrize(
    ("was", "left", "confirmed", "word"),
    [
        (None, 1.0, True, "not_measured"),
        (1.0, None, False, "not_measured"),
        (10.0, 3.1, True, "explained"),  # 90 % of the square
        (10.0, 3.3, True, "partly"),
        (1.0, 0.5, True, "explained"),  # what is left is small
        (0.5, 0.5, False, "none"),
        (0.6, 0.6, False, "unexplained"),
    ],
)
def test_a_stage_is_judged_by_its_own_millimetres(
    was: float | None, left: float | None, confirmed: bool, word: str
) -> None:
    assert stage_verdict(was, left, confirmed, small=0.5) == word


def test_what_a_healthy_machine_leaves_is_read_from_its_baseline() -> None:
    remainders = {("structure", None, "tracker"): Remainder("structure", None, "tracker", 1e-4, 1e-4, level=1.3)}
    nominal = SimpleNamespace(baseline_remainder=lambda *place: remainders.get(place))
    for known, level in ((nominal, 1.3), (None, 1.0)):
        assert usual_level(cast(Any, SimpleNamespace(nominal_machine=known)), "structure", None, "tracker") == level


@pytest.mark.parametrize(
    ("gain_nats", "prior_nats", "shown"), [(212.0, -3.9, True), (1.0, -3.9, False), (212.0, None, False)]
)
def test_a_doubtful_effect_with_a_clear_gain_shows_a_gap_given_a_baseline(
    gain_nats: float, prior_nats: float | None, shown: bool
) -> None:
    evidence = cast(Any, SimpleNamespace(gain_nats=gain_nats, prior_nats=prior_nats))
    assert shows_a_gap(EffectLine(evidence, "stands", 1.0, 0.9, 1.1, 1.0, 1.0, 0.01)) is shown
