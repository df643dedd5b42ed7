"""Names that may be none: a wait for the PLC's next cycle looks like a delay of part of it, and the stairs of a coarse
encoder like a play.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnosis.verdict.verdict import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from diagnosis.search.limits import Interval
    from diagnosis.verdict.cell_answer import CellAnswer

PLAY = "backlash"
NEXT_TO_NONE = 0.1  # of the size found: a limit below it is none, give or take the limits' own precision


def maybe_none(
    verdict: Verdict,
    answers: tuple[CellAnswer, ...],
    numbers: Mapping[int, tuple[Interval, ...]],
    steps_rad: Mapping[int, float],
) -> Verdict:
    """The verdict; undecided where effects were told of which one may be none by the 90 % limits of its size, or is a
    play within one step of its encoder: such a play takes the stairs out of what the encoder says.

    Args: numbers: limits of every number by its score's identity; steps_rad: of the encoders, by joint.
    """
    if verdict.word != "effects":
        return verdict
    for one in answers:
        limits = iter(numbers.get(id(one.chosen), ()))
        for effect in one.chosen.fit.hypothesis:
            own = [limit for _, limit in zip(effect.slots, limits, strict=False)]
            if not own or effect.vector or effect.slots[0].neutral != 0.0:
                continue
            where = "" if effect.joint is None else f" on joint {effect.joint}"
            step_rad = steps_rad.get(effect.joint or 0, 0.0)
            if effect.name == PLAY and own[0].value < step_rad:
                text = f"{effect.name}{where} of {1e3 * own[0].value:.3g} mrad is less than one step of the encoder, "
                return Verdict("undecided", f"{text}{1e3 * step_rad:.3g} mrad: what rounds may look like a play")
            if not _reaches_none(own[0]) or _never_waited(one):
                continue
            text = f"{effect.name}{where} explains some of the gap, but may be none: {effect.slots[0].parameter} = "
            text += f"{own[0].value:.3g}, 90 % {own[0].low:.3g} to {own[0].high:.3g}"
            return Verdict("undecided", f"{text}; log every PLC cycle, or record more, to tell")
    return verdict


def _never_waited(one: CellAnswer) -> bool:
    """Whether it is a link whose undisturbed days are known: a wait for the next cycle that they never showed is a
    delay of up to a cycle, however little of it can be told.
    """
    return one.search.cell.stage == "link" and one.search.cell.known_well


def _reaches_none(size: Interval) -> bool:
    nearest = size.low if size.value > 0.0 else -size.high
    return nearest <= NEXT_TO_NONE * abs(size.value)
