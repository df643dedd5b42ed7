"""A machine that moves by itself: repeats of one command differ by more than the command asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from diagnosis.log.tables import filled
from diagnosis.noise.floor import BLOCK_S, increments
from diagnosis.verdict.verdict import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from diagnosis.replay.stretches import Stretch

FLOOR_MIN = 0.02  # rad/s or m/s: below it a joint that hardly moves has an encoder's noise, and no motion of its own


def moves_by_itself(verdict: Verdict, floors: Mapping[int, float], stretches: tuple[Stretch, ...]) -> Verdict:
    """The verdict; undecided where nothing was named, and the floor that repeats gave of a joint's speed is larger than
    the speed it was asked for: in such a floor any fault disappears.

    Args: floors: RMS speed [rad/s or m/s] by which repeats differ, by joint (1-based).
    """
    if verdict.word != "none":
        return verdict
    for joint, floor in floors.items():
        asked = asked_speed(stretches, joint)
        if asked is not None and floor > max(asked, FLOOR_MIN):
            text = (
                f"actuator {joint}: repeats of one command differ by {floor:.2g} 1/s, and it asks for {asked:.2g} only"
            )
            text += ": it moves by itself (a loop that hunts, a person, a loose encoder)"
            return Verdict("undecided", f"{text}; calm it, or ask for more motion")
    return verdict


def asked_speed(stretches: tuple[Stretch, ...], joint: int) -> float | None:
    """RMS speed of a joint's reference over all stretches [rad/s or m/s]; None where there is no reference."""
    squares = [
        (increments(filled(one.ref)[:, [joint - 1]], one.dt_s) / max(BLOCK_S, one.dt_s)) ** 2
        for one in stretches
        if one.ref is not None
    ]
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else None
