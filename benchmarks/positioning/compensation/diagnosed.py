"""The effects of one machine by its recordings: a baseline fitted to one, judged on others, a diagnosis beyond it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diagnosis.baseline.left_over import cells_of, remainders_of, with_baseline
from diagnosis.budget import budget_of
from diagnosis.reading.read import Read, examine_recording
from machine.effects.entries import EffectEntry
from recording.content import Recording

CLOSED_MIN = 0.8  # of the squared gap on a recording not used for the fit: less is no cause, and is not compensated


@dataclass(frozen=True)
class Found:
    """Effects, and what stands for them: the verdict with them, and the share of the gap closed on that recording."""

    effects: tuple[EffectEntry, ...]
    verdict: str
    closed_frac: float
    why: str

    @property
    def usable(self) -> bool:
        """Whether the server may compensate them: the diagnosis is settled, and the gap was closed by them."""
        return bool(self.effects) and self.verdict in ("none", "effects") and self.closed_frac >= CLOSED_MIN


def effects_of(fitted: Recording, left: Recording, judged: Recording) -> Found:
    """Fit on one recording, measure what is left of the model's form on a second, diagnose a third.

    Model: as `longreach diagnose --fit-baseline` and then `longreach diagnose` with the file that it makes; the second
           step's count of what each effect gains by chance is left out here.
    """
    effects = budget_of(_read(fitted)).effect_entries()
    remainder = remainders_of([with_baseline(_read(left), effects, ())])
    last = _read(judged)
    before, after = (_energy(with_baseline(last, some, ())) for some in ((), effects))
    found = budget_of(with_baseline(last, effects, remainder))
    closed = 1.0 - (after - 1.0) / max(before - 1.0, 1e-9)
    return Found((*effects, *found.effect_entries()), found.verdict, closed, found.verdict_reason)


def _read(recording: Recording) -> Read:
    whole = examine_recording(recording, Path("tour"))
    if not whole.has_judgeable_stage:
        raise RuntimeError("; ".join(str(one) for one in whole.findings))
    return whole


def _energy(whole: Read) -> float:
    """Mean squared residual in floors."""
    rows = [cell.whitened(cell.baseline_parameters)[0] for cell in cells_of(whole)]
    return float(np.mean(np.concatenate(rows) ** 2)) if rows else 1.0
