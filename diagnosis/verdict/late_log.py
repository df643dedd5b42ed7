"""One cause behind several names: encoders that the log shows filtered or late, in all joints by the same.

Why: a filter of 40 ms before the log looks like a valve's lag of 38 ms in every joint, like a controller a tenth too
     soft, and like a tracker whose clock is 35 ms off. Each name alone fits; that they agree is what tells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.verdict.cell_answer import CellAnswer, joints_asked

LAG, CLOCK = "valve_lag", "clock_offset"
ALIKE = 0.1  # share by which the joints' lags differ at most
ALIKE_CLOCK = 0.25  # the clock sees a filter's delay, a lag its shape
JOINTS_MIN = 2


@dataclass(frozen=True, slots=True)
class LateLog:
    """By how much the log may be late [s], in which joints (1-based); whether a clock behind the encoders agrees."""

    by_s: float
    joints: tuple[int, ...]
    seen_by_clock: bool

    @property
    def words(self) -> str:
        """In a sentence's part."""
        joints = ", ".join(map(str, self.joints))
        text = f"joints {joints} all lag by {1e3 * self.by_s:.2g} ms"
        if self.seen_by_clock:
            return f"{text}, and what is measured behind them is as much earlier: the encoders' log is filtered or late"
        return f"{text}: encoders whose log is filtered or late look the same"


def late_log(answers: tuple[CellAnswer, ...]) -> LateLog | None:
    """None where fewer than two joints lag, their lags differ, or another driven joint has none."""
    lags: dict[int, float] = {}
    clocks: list[float] = []
    for answer in answers:
        for effect, theta in answer.chosen.fit.by_effect:
            if effect.name == LAG and effect.joint is not None:
                lags[effect.joint] = float(theta[0])
            elif effect.name == CLOCK:
                clocks.append(float(theta[0]))
    by_s = float(np.median(list(lags.values()))) if lags else 0.0
    if (
        len(lags) < JOINTS_MIN
        or set(lags) != joints_asked(answers, LAG)
        or max(abs(one - by_s) for one in lags.values()) > ALIKE * by_s
    ):
        return None
    agreeing = any(abs(-one - by_s) < ALIKE_CLOCK * by_s for one in clocks)
    return LateLog(by_s, tuple(sorted(lags)), agreeing)
