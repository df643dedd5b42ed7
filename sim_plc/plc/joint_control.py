"""The paper's joint controllers: P (eq. 6), and PT-1 (eq. 25) on the joints that carry the weight."""

import numpy as np
from numba import njit

from machine.rotations import Array
from sim_plc.plc.settings import PlcSettings


@njit(cache=True)
def valve_commands(q_ref: Array, q: Array, kp: Array, pt1_share: Array, fade: float, lagged: Array, out: Array) -> None:
    """One cycle of all joints into `out` (n,); `lagged` (n,) is kept from cycle to cycle."""
    for j in range(q.shape[0]):
        u = kp[j] * (q_ref[j] - q[j])  # eq. 6
        lagged[j] += pt1_share[j] * (u - lagged[j])  # eq. 25 over one cycle; a share of 1 is plain P
        out[j] = min(max(lagged[j], -1.0), 1.0) * fade


class JointControl:
    """Valve commands (n,) [fraction of full command] from the reference and the encoders.

    Model:   u = kp (q_ref - q), followed by 1 / (tau s + 1) where tau > 0 (exact for an input held over the cycle);
             then clipped to -1..1, and times the fade (1 but during a ramp).
    Source:  the paper, eqs. 6 and 25.
    """

    def __init__(self, settings: PlcSettings) -> None:
        self._settings = settings
        self._lagged = np.zeros(settings.n)
        self.valves = np.zeros(settings.n)

    def neutral(self) -> Array:
        """Valves closed, PT-1 states forgotten."""
        self._lagged[:] = 0.0
        self.valves[:] = 0.0
        return self.valves

    def control(self, q_ref: Array, q: Array, fade: float) -> Array:
        """Valve commands of this cycle, times fade; a view that the next cycle changes."""
        settings = self._settings
        valve_commands(q_ref, q, settings.kp, settings.pt1_share, fade, self._lagged, self.valves)
        return self.valves
