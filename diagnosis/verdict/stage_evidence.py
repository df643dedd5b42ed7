"""How strongly each stage is known to be wrong: this divides the gap among the stages where their motions overlap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnosis.refusal.remainder import UNREST
from diagnosis.refusal.shapes import TEST as SHAPE

if TYPE_CHECKING:
    from diagnosis.verdict.cell_answer import CellAnswer


def nats_by_stage(answers: tuple[CellAnswer, ...]) -> dict[str, float]:
    """By stage, what its named effects gain, and what tests that fired find left there [nats].

    Where all names are one stage's, what they gain is that stage's, whoever saw it: a camera shows an arm's swing, too.
    A shape says how much it foretells: that may be little beside all that a stage's rows differ from their floor by.
    """
    out: dict[str, float] = {}
    for one in answers:
        cell, none, chosen = one.search.cell, one.search.none.held_out, one.chosen.held_out
        told = {fired.stage for fired in one.fired if fired.test != SHAPE}
        named = {candidate.stage for candidate in one.chosen.fit.hypothesis}
        owner = min(named) if len(named) == 1 and named <= {part.stage for part, _ in cell.by_part(none)} else ""
        for (part, before), (_, after) in zip(cell.by_part(none), cell.by_part(chosen), strict=True):
            gained = 0.5 * float(before @ before - after @ after) if one.chosen.fit.hypothesis else 0.0
            left = 0.5 * float(after @ after - len(after)) if part.stage in told else 0.0
            unrest = [fired.share for fired in one.fired if (fired.test, fired.stage) == (UNREST, part.stage)]
            left = max(left, 0.5 * max(unrest, default=0.0) * float(after @ after))
            at = owner or part.stage
            out[at] = out.get(at, 0.0) + max(gained, 0.0)
            out[part.stage] = out.get(part.stage, 0.0) + left
        shaped: dict[str, float] = {}
        for fired in one.fired:
            if fired.test == SHAPE:
                shaped[fired.stage] = max(shaped.get(fired.stage, 0.0), fired.size)
        for stage, nats in shaped.items():
            out[stage] = out.get(stage, 0.0) + nats
    return out
