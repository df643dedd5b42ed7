"""An effect left out of the library: cached fits are reused and the name is gone."""

from made_up_cell import made_up

from diagnosis.search.fit import Fit
from diagnosis.search.score import score
from diagnosis.search.search import search, searched_without


def test_a_name_left_out_is_gone_and_nothing_else_is_fitted_again(monkeypatch) -> None:
    cell = made_up((0.15, 0.0, 0.0))
    found = search(cell)
    (chosen,) = found.chosen.fit.hypothesis
    fitted: list[tuple[str, ...]] = []

    def counted(cell, fit: Fit):
        fitted.append(tuple(one.name for one in fit.hypothesis))
        return score(cell, fit)

    monkeypatch.setattr("diagnosis.search.several.score", counted)
    left = searched_without(found, chosen.name)
    assert all(one.name != chosen.name for s in left.scored for one in s.fit.hypothesis)
    assert all(one.candidate.name != chosen.name for one in left.scans)
    known = {tuple(one.name for one in s.fit.hypothesis) for s in found.scored}
    assert not known & set(fitted)
    assert left.none is found.none


def test_leaving_out_what_was_not_named_changes_nothing() -> None:
    found = search(made_up((0.15, 0.0, 0.0)))
    named = {one.name for one in found.chosen.fit.hypothesis}
    other = next(one.name for one in found.cell.candidates if one.name not in named)
    left = searched_without(found, other)
    assert left.chosen.fit.hypothesis == found.chosen.fit.hypothesis
    assert left.chosen.total == found.chosen.total
