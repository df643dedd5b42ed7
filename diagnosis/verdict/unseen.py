"""Effects too small for a recording to show: what the answer would be with one more name, and how likely that is.

Whatever was found, another effect below its detection limit may be at work, too. How often that is so was counted on a
simulated set, by verdict and certainty (`calibration.json`); which one it is, the scores can say a little about.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from diagnosis.verdict.weigh import Key, calibration

if TYPE_CHECKING:
    from diagnosis.verdict.cell_answer import CellAnswer

SURE = 0.95
GAIN_MAX_NATS = 6.0  # what gains more and was not named has other reasons against it


def counted_as(word: str, share: float) -> str:
    """Under which heading of calibration.json an answer was counted: its verdict, and names with hardly a rival apart.

    `share`: of the first hypothesis and its equals among what the catalogue explains.
    Why apart: of 70 answers from 0.95 on one in nine was wrong or lacked something, of 158 below it one in three.
    """
    return "sure" if word == "effects" and share >= SURE else word


def outside_share(counted: str) -> float:
    """Probability that a cause outside the catalogue is at work."""
    return dict(calibration().outside_probability)[counted]


def unseen_share(counted: str) -> float:
    """Probability that the catalogue's answer lacks a name that is too small to be seen."""
    return dict(calibration().unseen_probability).get(counted, 0.0)


def one_more(cells: tuple[CellAnswer, ...], named: frozenset[Key]) -> tuple[tuple[Key, float], ...]:
    """Every other name that the recording could have shown, and its part of that probability; the largest first.

    Model: p_i ~ exp(gain_i / T), the gain [nats] of name i alone, held out, 0 to 6: one that the recording says nothing
           of is as likely as any other.
    """
    T, gains = calibration().temperature, dict[Key, float]()
    for one in cells:
        none, spread = one.search.none.total, one.search.spread
        for scan in one.search.scans:
            gains.setdefault(scan.candidate.key, 0.0)
        for score in one.search.scored:
            if len(score.fit.hypothesis) == 1:
                key = score.fit.hypothesis[0].key
                gain = min(max((score.total - none) / spread, 0.0), GAIN_MAX_NATS)
                gains[key] = max(gains.get(key, 0.0), gain)
    keys = [key for key in gains if key not in named]
    weights = np.exp(np.array([gains[key] for key in keys]) / T)
    parts = weights / weights.sum() if keys else weights
    order = np.argsort(-parts, kind="stable")
    return tuple((keys[k], float(parts[k])) for k in order)
