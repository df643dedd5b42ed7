"""Servo mode: the reference chases a moving target, never faster nor harder than the joints may."""

import numpy as np
from numba import njit

from machine.rotations import Array
from protocol.codes import CommandFlag, Interp, RejectCode
from protocol.messages import Axes, Command
from protocol.objection import Objection, object_to, object_to_knot
from protocol.timeouts import SERVO_STALE_TIMEOUT, SERVO_TARGET_LEAD_MAX_S
from sim_plc.plc.knot_checks import check_unused
from sim_plc.plc.settings import PlcSettings

_ROUNDING = 1e-9
_BRAKE = 0.9  # of qdd_max is what braking is planned with: the rest is for a target that moves
_AT_TARGET_RAD = 1e-7  # 0.5 um at 5 m
_STILL_RAD_S = 1e-6  # rest, as knots have it


@njit(cache=True)
def _braking_speed(distance: float, decel: float, dt: float) -> float:
    """The speed from which a joint still stops within `distance` when it brakes by decel in steps of dt.

    Model:   v^2 / (2 a) + v dt / 2 = d, the sum of the steps; for less than one step's way, the speed that lands there.
    """
    if distance <= 0.0:
        return 0.0
    if distance <= decel * dt * dt:
        return distance / dt
    half = 0.5 * decel * dt
    return np.sqrt(half * half + 2.0 * decel * distance) - half


@njit(cache=True)
def step_towards_target(
    out: Array,
    target: Array,
    speed: Array,
    q_min: Array,
    q_max: Array,
    qd_max: Array,
    qdd_max: Array,
    share: float,
    dt: float,
) -> bool:
    """Move dt towards a target that moves with `speed`; out (3, n): q, qd, qdd. Returns whether all rest on it.

    Model:   per joint: wanted = speed of the target + braking speed for the way to it, within +-qd_max * share and
             within the braking speed for the way to either end of the range; then |change| <= qdd_max dt.
    """
    arrived = True
    for j in range(out.shape[1]):
        decel = _BRAKE * qdd_max[j]
        away = target[j] - out[0, j]
        brake = _braking_speed(abs(away), decel, dt)
        wanted = speed[j] + (brake if away > 0.0 else -brake)
        top = qd_max[j] * share
        high = min(top, _braking_speed(q_max[j] - out[0, j], decel, dt))
        low = -min(top, _braking_speed(out[0, j] - q_min[j], decel, dt))
        wanted = min(max(wanted, low), high)
        step = qdd_max[j] * dt
        before = out[1, j]
        after = min(max(wanted, before - step), before + step)
        out[0, j] += after * dt
        out[1, j] = after
        out[2, j] = (after - before) / dt
        if speed[j] != 0.0 or abs(target[j] - out[0, j]) > _AT_TARGET_RAD or abs(after) > _STILL_RAD_S:
            arrived = False
    return arrived


class Servo:
    """The newest target, and how it moves on until the next one comes."""

    def __init__(self, settings: PlcSettings) -> None:
        self._settings = settings
        self._target, self._speed = np.zeros(settings.n), np.zeros(settings.n)
        self._at, self._moving = np.zeros(settings.n), np.zeros(settings.n)
        self._t_target_ns = 0
        self.left_s = 0.0  # for how long the target still moves on without news
        self.ending = False

    def load_target(self, command: Command, t_plc_ns: int) -> None:
        """Take the target of a command that was checked in the same cycle."""
        n, knot = self._settings.n, command.knots[0]
        self._target[:] = knot.q[:n]
        self._speed[:] = knot.qd[:n]
        self._t_target_ns = t_plc_ns
        self.left_s = SERVO_STALE_TIMEOUT.duration_ns * 1e-9
        self.ending = CommandFlag.LAST_IS_END in command.cmd_flags

    def step(self, out: Array, share: float, t_plc_ns: int) -> bool:
        """Move the reference on by one cycle; whether it rests on a last target."""
        s = self._settings
        age_ns = t_plc_ns - self._t_target_ns
        age_s = min(age_ns, SERVO_STALE_TIMEOUT.duration_ns) * 1e-9
        self.left_s = max(SERVO_STALE_TIMEOUT.duration_ns - age_ns, 0) * 1e-9
        stale = age_ns >= SERVO_STALE_TIMEOUT.duration_ns or self.ending
        for j in range(s.n):
            reach = self._target[j] + self._speed[j] * age_s
            self._at[j] = min(max(reach, s.q_min[j]), s.q_max[j])
            self._moving[j] = 0.0 if stale or self._at[j] != reach else self._speed[j]
        arrived = step_towards_target(
            out, self._at, self._moving, s.q_min, s.q_max, s.qd_max, s.qdd_stop, share, s.cycle_s
        )
        return arrived and self.ending


def check_target(command: Command, q_ref: Axes, settings: PlcSettings) -> Objection | None:
    """Whether the PLC takes a servo command: one target, in range, at a speed and a distance that make sense."""
    if command.interp is not Interp.LINEAR:
        return object_to(RejectCode.INTERP, "interp")
    if len(command.knots) != 1:
        return object_to(RejectCode.VALUE, "knot_count")
    knot, table = command.knots[0], settings.limit_table
    unused = check_unused(knot, 0, table)
    if unused is not None:
        return unused
    for j, axis in enumerate(table.axes):
        if not abs(knot.qd[j]) <= axis.qd_max * (1.0 + _ROUNDING):
            return object_to_knot(RejectCode.LIMIT_QD, 0, "qd", j)
        if not axis.q_min - _ROUNDING <= knot.q[j] <= axis.q_max + _ROUNDING:
            return object_to_knot(RejectCode.LIMIT_Q, 0, "q", j)
        if not abs(knot.q[j] - q_ref[j]) <= axis.qd_max * SERVO_TARGET_LEAD_MAX_S:
            return object_to_knot(RejectCode.IMPLIED_SPEED, 0, "q", j)
    return None
