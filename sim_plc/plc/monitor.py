"""What the PLC watches in every cycle: lag, range, sensors, oil. Faults latch until RESET, warnings do not."""

import numpy as np
from numba import njit

from machine.rotations import Array
from protocol.codes import FaultBit, WarnBit
from sim_plc.plc.settings import OIL_FAULT_C, OIL_WARN_C, RANGE_MARGIN_RAD, SUPPLY_WARN_PA, PlcSettings

_SENSOR, _RANGE, _LAG_WARN, _LAG_FAULT = 1, 2, 4, 8


@njit(cache=True)
def _findings(
    q: Array, qd: Array, q_ref: Array, q_min: Array, q_max: Array, lag_warn: Array, lag_fault: Array, margin: float
) -> int:
    bits = 0
    for j in range(q.shape[0]):
        if not (np.isfinite(q[j]) and np.isfinite(qd[j])):
            bits |= _SENSOR
        elif q[j] < q_min[j] - margin or q[j] > q_max[j] + margin:
            bits |= _RANGE
        lag = abs(q_ref[j] - q[j])
        if lag > lag_warn[j]:
            bits |= _LAG_WARN
        if lag > lag_fault[j]:
            bits |= _LAG_FAULT
    return bits


class Monitor:
    """Findings of the present cycle, and the latched faults."""

    def __init__(self, settings: PlcSettings) -> None:
        self._settings = settings
        self.latched = FaultBit(0)
        self.present = FaultBit(0)
        self.warnings = WarnBit(0)
        self._last = (-1, False, False, False)

    def look(self, q: Array, qd: Array, q_ref: Array, p_supply_pa: float, t_oil_c: float, controlled: bool) -> FaultBit:
        """The faults present in this cycle; lag and range only count while the PLC moves the machine."""
        s = self._settings
        bits = _findings(q, qd, q_ref, s.q_min, s.q_max, s.lag_warn, s.lag_fault, RANGE_MARGIN_RAD)
        findings = (bits, controlled, p_supply_pa < SUPPLY_WARN_PA, t_oil_c > OIL_WARN_C)
        if findings != self._last or t_oil_c > OIL_WARN_C:
            self._last = findings
            self._classify(*findings, t_oil_c)
        return self.present

    def latch(self, faults: FaultBit) -> None:
        """Keep faults until `clear`."""
        self.latched |= faults

    def clear(self) -> None:
        """RESET: only what is still present stays."""
        self.latched = self.present

    def _classify(self, bits: int, controlled: bool, low_supply: bool, hot_oil: bool, t_oil_c: float) -> None:
        present = FaultBit.SENSOR if bits & _SENSOR else FaultBit(0)
        if controlled and bits & _RANGE:
            present |= FaultBit.JOINT_RANGE
        if controlled and bits & _LAG_FAULT:
            present |= FaultBit.LAG
        if t_oil_c > OIL_FAULT_C:
            present |= FaultBit.OIL_TEMPERATURE
        warnings = WarnBit.LAG if controlled and bits & _LAG_WARN else WarnBit(0)
        if low_supply:
            warnings |= WarnBit.PRESSURE
        if hot_oil:
            warnings |= WarnBit.OIL_TEMPERATURE
        self.present, self.warnings = present, warnings
