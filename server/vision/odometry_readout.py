"""How long the rolling shutter takes from the first row to the last: told, or learned from the motion itself."""

from dataclasses import dataclass

import numpy as np

SIGMA_S = 0.010  # before anything was seen: from a global shutter to that of a 60 Hz camera
MAX_S = 0.040
FRESH_FRAC = 0.1  # of a pair's information: the rest it shares with its neighbours (same patches, same map)
SIGMA_MIN_S = 2e-4  # never surer: later pairs must be able to correct it


@dataclass(frozen=True, slots=True)
class Readout:
    """Readout [s] and its sigma [s]; sigma 0 = told, never changed."""

    value_s: float
    sigma_s: float

    @property
    def size_s(self) -> float:
        """How long it may well be: what a wrong velocity is multiplied by."""
        return float(np.hypot(self.value_s, self.sigma_s))

    def learned(self, step_s: float, information: float) -> "Readout":
        """After one more pair said: change it by `step_s`, with this information [1/s^2]."""
        if self.sigma_s == 0.0 or information <= 0.0:
            return self
        known, fresh = self.sigma_s**-2, FRESH_FRAC * information
        value = float(np.clip(self.value_s + step_s * fresh / (known + fresh), -MAX_S, MAX_S))
        return Readout(value, max(float((known + fresh) ** -0.5), SIGMA_MIN_S))


def readout_of(readout_s: float | None) -> Readout:
    """As told, or unknown."""
    return Readout(0.0, SIGMA_S) if readout_s is None else Readout(readout_s, 0.0)
