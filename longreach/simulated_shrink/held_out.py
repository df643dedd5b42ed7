"""Held-out effects of a stretch: fitted without that stretch's kind of trajectory."""

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.baseline.forward import entries_of
from diagnosis.diagnose import Diagnosis
from diagnosis.replay.stage_replay import Replay
from diagnosis.replay.stretches import Stretch
from diagnosis.verdict.cell_answer import CellAnswer
from machine.effects.entries import EffectEntry


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Effects for one stretch. `held_out`: each of their numbers was fitted without this stretch."""

    entries: tuple[EffectEntry, ...]
    held_out: bool


def effects_without(found: Diagnosis, stretch: Stretch) -> HeldOut:
    """The chosen effects of every cell, those of driven cells refitted without the stretch's fold.

    Raises: DiagnosisError: a fitted number that is outside its effect's bounds.
    """
    entries: list[EffectEntry] = []
    held_out = True
    for cell in found.cells:
        if not cell.chosen.fit.hypothesis:
            continue
        fold = _fold_of(cell, stretch)
        fit = cell.chosen.fit
        if fold is None:
            held_out = held_out and not isinstance(cell.search.cell.whitened, Replay)
        else:
            fit = replace(fit, theta=cell.chosen.folds.theta_without(fold))
        entries += entries_of(fit)
    return HeldOut(tuple(entries), held_out)


def _fold_of(one: CellAnswer, stretch: Stretch) -> int | None:
    """The fold that all of a stretch belongs to in a driven cell; None where the cell does not see it, or cuts it."""
    replay, rows = one.search.cell.whitened, one.search.cell.rows
    if not isinstance(replay, Replay):
        return None
    at = next((k for k, part in enumerate(replay.parts) if part.stretch.name == stretch.name), None)
    if at is None:
        return None
    mine = np.unique(rows.fold[rows.series // len(replay.joints) == at])
    return int(mine[0]) if len(mine) == 1 else None
