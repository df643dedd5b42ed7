"""How probable the names found are, all together and one by one, whatever is beside them."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from diagnosis.search.candidates import in_words
from diagnosis.search.score import Score

if TYPE_CHECKING:
    from diagnosis.verdict.cell_answer import CellAnswer
    from diagnosis.verdict.weigh import Whole

CERTAIN = 0.9  # probability of one name, with its equals, from which it is told beside doubtful ones


def probability_of_names(answers: tuple[CellAnswer, ...]) -> float:
    """Probability that the names are at work, or their equals, alone or beside others, in the cells of the names.

    Why only those: what may be at work elsewhere, too small to be told, takes no name back. Over all cells together
    such small doubts multiplied to a half: in 327 cases six answers with the right names were refused by it, and one
    with a wrong name.
    """
    total = 1.0
    for answer in answers:
        if answer.chosen.fit.hypothesis:
            total *= _share(answer, Counter(_class(answer, one.key) for one in answer.chosen.fit.hypothesis))
    return total


def share_of_first(answers: tuple[CellAnswer, ...], hypotheses: tuple[Whole, ...]) -> float:
    """Probability of the first hypothesis and of all that only put equal names in the place of its own."""
    named = [[_names(answer, score) for answer, score in zip(answers, one.scores, strict=True)] for one in hypotheses]
    return sum(one.probability for one, names in zip(hypotheses, named, strict=True) if names == named[0])


def certain_in_words(answers: tuple[CellAnswer, ...]) -> str:
    """Those of the names, with their equals, that nearly every hypothesis holds: the doubt is of the others."""
    told = []
    for answer in answers:
        for effect in answer.chosen.fit.hypothesis:
            share = _share(answer, Counter([_class(answer, effect.key)]))
            if share >= CERTAIN:
                names = next((members for members in answer.same if effect.key in members), (effect.key,))
                told.append(f"{' or '.join(in_words(*key) for key in names)} ({share:.2g})")
    return f"; of them certain: {', '.join(told)}" if told else ""


def _share(answer: CellAnswer, names: Counter[str]) -> float:
    """Probability of all hypotheses of a cell that hold these classes of names."""
    return sum(one.probability for one in answer.weighed if names <= _names(answer, one.score))


def _names(answer: CellAnswer, score: Score) -> Counter[str]:
    return Counter(_class(answer, effect.key) for effect in score.fit.hypothesis)


def _class(answer: CellAnswer, key: tuple[str, int | None]) -> str:
    for members in answer.same:
        if key in members:
            return str(members[0])
    return str(key)
