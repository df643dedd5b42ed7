"""Per-cycle monitoring of lag, range, encoders and oil; faults latch until RESET, warnings do not."""

import numpy as np
from numba import njit

from machine.rotations import Array
from protocol.codes import FaultBit, WarnBit
from sim_plc.plc.settings import (
    ENCODER_JUMP_FACTOR,
    ENCODER_JUMP_RAD,
    OIL_FAULT_C,
    OIL_WARN_C,
    RANGE_MARGIN_RAD,
    SUPPLY_FAULT_PA,
    SUPPLY_WARN_PA,
    PlcSettings,
)

_SENSOR, _RANGE, _LAG_WARN, _LAG_FAULT = 1, 2, 4, 8


@njit(cache=True)
def _joint_finding_bits(
    q: Array, qd: Array, q_ref: Array, q_min: Array, q_max: Array, lag_warn: Array, lag_fault: Array, margin: float
) -> int:
    bits = 0
    for j in range(q.shape[0]):
        if not (np.isfinite(q[j]) and np.isfinite(qd[j])):
            bits |= _SENSOR  # and nothing else can be said of this joint
            continue
        if q[j] < q_min[j] - margin or q[j] > q_max[j] + margin:
            bits |= _RANGE
        lag = abs(q_ref[j] - q[j])
        if lag > lag_warn[j]:
            bits |= _LAG_WARN
        if lag > lag_fault[j]:
            bits |= _LAG_FAULT
    return bits


@njit(cache=True)
def _encoder_jump_bits(q: Array, q_before: Array, qd_max: Array, since_s: float) -> int:
    """Bit j: the encoder went further since the last reading than its joint can; those that are no numbers do not."""
    bits = 0
    for j in range(q.shape[0]):
        most = ENCODER_JUMP_RAD + ENCODER_JUMP_FACTOR * qd_max[j] * since_s
        if np.isfinite(q[j]) and np.isfinite(q_before[j]) and abs(q[j] - q_before[j]) > most:
            bits |= 1 << j
    return bits


class Monitor:
    """Findings of the present cycle, and the latched faults."""

    def __init__(self, settings: PlcSettings) -> None:
        self._settings = settings
        self.latched = FaultBit(0)
        self.present = FaultBit(0)
        self.warnings = WarnBit(0)
        self.jumped = 0  # bit j: that encoder did, since the last RESET
        self._q_before = np.full(settings.n, np.nan)
        self._last: tuple[int, ...] = (-1,)

    def look(
        self,
        q: Array,
        qd: Array,
        q_ref: Array,
        p_supply_pa: float,
        t_oil_c: float,
        controlled: bool,
        dry_run: bool = False,
        since_s: float = 0.0,
    ) -> FaultBit:
        """The faults present in this cycle, `since_s` after the last one.

        Range, jumps and pressure only count while the PLC moves the machine, lag not in a dry run either.
        """
        s = self._settings
        bits = _joint_finding_bits(q, qd, q_ref, s.q_min, s.q_max, s.lag_warn, s.lag_fault, RANGE_MARGIN_RAD)
        jumps = _encoder_jump_bits(q, self._q_before, s.qd_max, since_s) if controlled else 0
        if jumps:
            self.jumped |= jumps
            bits |= _SENSOR
        self._q_before[:] = q
        if dry_run or not controlled:
            bits &= ~(_LAG_WARN | _LAG_FAULT)
        if not controlled:
            bits &= ~_RANGE
        supply = 2 * (controlled and not dry_run and p_supply_pa < SUPPLY_FAULT_PA) + (p_supply_pa < SUPPLY_WARN_PA)
        oil = 2 * (t_oil_c > OIL_FAULT_C) + (t_oil_c > OIL_WARN_C)
        findings = (bits, supply, oil)
        if findings != self._last:
            self._last = findings
            self._classify(*findings)
        return self.present

    def latch(self, faults: FaultBit) -> None:
        """Keep faults until `clear`."""
        self.latched |= faults

    def clear(self) -> None:
        """RESET: only what is still present stays."""
        self.latched = self.present
        self.jumped = 0

    def _classify(self, bits: int, supply: int, oil: int) -> None:
        found = (
            (bits & _SENSOR, FaultBit.SENSOR),
            (bits & _RANGE, FaultBit.JOINT_RANGE),
            (bits & _LAG_FAULT, FaultBit.LAG),
            (supply & 2, FaultBit.PRESSURE),
            (oil & 2, FaultBit.OIL_TEMPERATURE),
        )
        warned = ((bits & _LAG_WARN, WarnBit.LAG), (supply & 1, WarnBit.PRESSURE), (oil & 1, WarnBit.OIL_TEMPERATURE))
        self.present, self.warnings = FaultBit(0), WarnBit(0)
        for is_there, fault in found:
            self.present |= fault if is_there else FaultBit(0)
        for is_there, warning in warned:
            self.warnings |= warning if is_there else WarnBit(0)
