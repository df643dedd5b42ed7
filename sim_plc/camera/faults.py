"""Camera faults for tests: a frozen picture, black pictures, one black eye."""

from enum import Enum

import numpy as np

from sim_plc.camera.texture import Grey


class FaultKind(Enum):
    """What is wrong with the pictures; their stamps go on."""

    NONE = "none"
    FREEZE = "freeze"
    BLACK = "black"
    LEFT_BLACK = "left_black"


class FaultSwitch:
    """Applies the chosen fault to every pair."""

    def __init__(self) -> None:
        self.kind = FaultKind.NONE
        self._last: tuple[Grey, Grey] | None = None

    def apply(self, left: Grey, right: Grey) -> tuple[Grey, Grey]:
        """The pair as the faulty camera gives it."""
        if self.kind is FaultKind.FREEZE and self._last is not None:
            return self._last
        self._last = (left, right)
        if self.kind is FaultKind.BLACK:
            return np.zeros_like(left), np.zeros_like(right)
        if self.kind is FaultKind.LEFT_BLACK:
            return np.zeros_like(left), right
        return left, right
