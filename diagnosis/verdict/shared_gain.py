"""One cause behind several names: every driven joint is as much too fast, or too slow, as every other.

Why: oil that warms and a supply that is set too high change all valves alike, and what an encoder too coarse to show
     their course leaves refuses nothing. One gain for each joint explains it as well; that they agree tells.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from diagnosis.search.limits import QUANTILE_95, Interval
from diagnosis.verdict.cell_answer import CellAnswer, joints_asked
from diagnosis.verdict.verdict import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

GAIN = "flow_gain_error"
JOINTS_MIN = 2
SHARED_NATS = 2.0  # seven times as likely by one cause as by one of each joint
APART = 0.02  # of the gain: how far joints that share a cause may differ, since they move at other times


def shared_gain(
    verdict: Verdict, answers: tuple[CellAnswer, ...], numbers: Mapping[int, tuple[Interval, ...]]
) -> Verdict:
    """The verdict; undecided where effects were told, and every driven joint has a gain that is the others' too.

    Args: numbers: limits of every number by its score's identity.
    """
    gains = _gains(answers, numbers) if verdict.word == "effects" else {}
    if (
        len(gains) < JOINTS_MIN
        or set(gains) != joints_asked(answers, GAIN)
        or shared_nats(tuple(gains.values())) < SHARED_NATS
    ):
        return verdict
    percent = 100.0 * float(np.mean([one.value for one in gains.values()]))
    joints = ", ".join(map(str, sorted(gains)))
    text = f"joints {joints} are all {abs(percent):.3g} % too {'fast' if percent > 0.0 else 'slow'}"
    return Verdict(
        "undecided",
        f"{text}: one cause that they share is likelier than {len(gains)} gains that happen to agree; "
        "look at the oil's temperature and the supply first",
    )


def shared_nats(gains: tuple[Interval, ...]) -> float:
    """By how much one gain for all is likelier than one of each, drawn as widely as they are large [nats]."""
    value = np.array([one.value for one in gains])
    own = np.array([(one.high - one.low) / (2.0 * QUANTILE_95) for one in gains])
    size = float(np.abs(value).mean())
    if size == 0.0:
        return 0.0
    own = np.hypot(own, APART * size)
    wide = own**2 + size**2
    mean = float(np.average(value, weights=own**-2))
    nats = 0.5 * np.log(wide / own**2) - 0.5 * (value - mean) ** 2 * (own**-2 - 1.0 / wide)
    return float(nats.mean() * (len(gains) - 1))  # the mean is one of the numbers


def _gains(answers: tuple[CellAnswer, ...], numbers: Mapping[int, tuple[Interval, ...]]) -> dict[int, Interval]:
    """Of each joint that has one."""
    out: dict[int, Interval] = {}
    for answer in answers:
        limits = numbers.get(id(answer.chosen), ())
        for effect, own in answer.chosen.fit.slices:
            if effect.name == GAIN and effect.joint is not None and limits:
                out[effect.joint] = limits[own][0]
    return out
