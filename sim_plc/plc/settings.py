"""Machine parameters of the PLC logic: limits, gains and thresholds, as arrays for the compiled loops."""

from dataclasses import dataclass

import numpy as np

from machine.description import Joint, Machine
from machine.rotations import Array
from protocol.limits import LimitTable, limits_of

LAG_FAULT_FACTOR = 2.0  # of the steady lag at full speed: more means that a joint does not follow at all
LAG_WARN_FACTOR = 1.3
LAG_FLOOR_RAD = 0.05  # a fast loop still needs room for gravity, friction and dead band
RANGE_MARGIN_RAD = 0.05  # a loaded joint may be pushed this far past its limit before it is a fault
ENCODER_JUMP_RAD = 0.01  # no joint goes this far, and three times its top speed, between two cycles: the encoder lies
ENCODER_JUMP_FACTOR = 3.0
ARMING_SPEED_MAX_RAD_S = 0.05  # faster than this while arming: the boom oscillates or a person moves it
SUPPLY_FAULT_PA = 2e6  # no pump at all: a joint would sink instead of following
SUPPLY_WARN_PA = 10e6  # half of the usual supply pressure: the pump does not keep up
OIL_WARN_C = 70.0
OIL_FAULT_C = 85.0
LOST_CYCLES_MAX = 5  # the PLC's clock steps further than this between two cycles: the task has been starved


@dataclass(frozen=True, slots=True)
class PlcSettings:
    """Limits and gains of n joints, arrays (n,); SI units."""

    limit_table: LimitTable
    cycle_ns: int
    q_min: Array
    q_max: Array
    qd_max: Array
    qdd_stop: Array  # the stop's deceleration: each joint's qdd_max
    kp_frac_per_rad: Array  # command fraction per rad
    pt1_share: Array  # of the way to its input that the PT-1 goes in one cycle; 1 = no PT-1
    lag_warn: Array
    lag_fault: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.limit_table.axes)

    @property
    def cycle_s(self) -> float:
        """The task's cycle [s]."""
        return self.cycle_ns * 1e-9


def steady_lag(joint: Joint) -> float:
    """How far a P-controlled joint trails its reference at full speed [rad].

    Model:   qd = g kp (q_ref - q) in steady state, so lag = qd_max / (g kp).
    """
    return joint.qd_max_rad_s / (joint.velocity_gain_rad_s * joint.kp_frac_per_rad)


def _read_only_array(values: list[float]) -> Array:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def plc_settings(machine: Machine) -> PlcSettings:
    """The settings that a PLC with this machine file loaded runs with."""
    joints, cycle_s = machine.joints, machine.plc_cycle_s
    lag = [steady_lag(joint) for joint in joints]
    shares = [1.0 - float(np.exp(-cycle_s / j.pt1_tau_s)) if j.pt1_tau_s > 0.0 else 1.0 for j in joints]
    return PlcSettings(
        limit_table=limits_of(joints),
        cycle_ns=round(cycle_s * 1e9),
        q_min=_read_only_array([joint.q_min_rad for joint in joints]),
        q_max=_read_only_array([joint.q_max_rad for joint in joints]),
        qd_max=_read_only_array([joint.qd_max_rad_s for joint in joints]),
        qdd_stop=_read_only_array([joint.qdd_max_rad_s2 for joint in joints]),
        kp_frac_per_rad=_read_only_array([joint.kp_frac_per_rad for joint in joints]),
        pt1_share=_read_only_array(shares),
        lag_warn=_read_only_array([max(LAG_WARN_FACTOR * value, LAG_FLOOR_RAD) for value in lag]),
        lag_fault=_read_only_array([max(LAG_FAULT_FACTOR * value, 2.0 * LAG_FLOOR_RAD) for value in lag]),
    )
