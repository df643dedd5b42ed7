"""Time laws: how the share of a path already covered grows with time, from rest to rest."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial import Polynomial

from server.motion.contracts import Array


class TimeLaw(Protocol):
    """s(u) with u = t / T in 0..1, s(0) = 0, s(1) = 1, at rest at both ends."""

    @property
    def peak(self) -> float:
        """Largest ds/du."""
        ...

    def derivatives(self, u: Array, highest: int) -> list[Array]:
        """s and its derivatives with respect to u, up to order `highest`, at u (n,)."""
        ...


@dataclass(frozen=True, slots=True)
class QuinticLaw:
    """The paper's point-to-point law 10 u^3 - 15 u^4 + 6 u^5: zero velocity and acceleration at both ends."""

    @property
    def peak(self) -> float:
        """Largest ds/du."""
        return 15.0 / 8.0

    def derivatives(self, u: Array, highest: int) -> list[Array]:
        """s and its derivatives with respect to u, up to order `highest`, at u (n,)."""
        s = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
        return [s(u), *(s.deriv(order)(u) for order in range(1, highest + 1))]


@dataclass(frozen=True, slots=True)
class CruiseLaw:
    """Even speed between two smooth ramps; zero up to the fourth derivative at both ends.

    Model:   ds/du = V S(u / r) on the ramp, S(x) = 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7, V = 1 / (1 - r); mirrored at the
             end. A reference shaped through two lags needs four vanishing derivatives to start and end smoothly.
    Args:    ramp_frac: r, share of the duration that each ramp takes, 0 < r <= 0.5.
    """

    ramp_frac: float

    @property
    def peak(self) -> float:
        """Largest ds/du."""
        return 1.0 / (1.0 - self.ramp_frac)

    def derivatives(self, u: Array, highest: int) -> list[Array]:
        """s and its derivatives with respect to u, up to order `highest`, at u (n,)."""
        r, V = self.ramp_frac, self.peak
        late = u > 0.5  # the second half is the first one turned about its middle: s(u) = 1 - s(1 - u)
        x = np.minimum(np.where(late, 1.0 - u, u) / r, 1.0)
        ramp = Polynomial([0.0, 0.0, 0.0, 0.0, 0.0, 7.0, -14.0, 10.0, -2.5]) * r * V
        first = ramp(x) + V * np.maximum(np.where(late, 1.0 - u, u) - r, 0.0)
        result = [np.where(late, 1.0 - first, first)]
        for order in range(1, highest + 1):
            value = ramp.deriv(order)(x) / r**order
            result.append(np.where(late, (-1.0) ** (order + 1) * value, value))
        return result
