"""The reference of the joint controllers: held, played from the ring, or ramped down; never a step in qd_ref."""

from enum import Enum

import numpy as np

from machine.rotations import Array
from protocol.timeouts import PLAUSIBLE_SPEED_FACTOR
from sim_plc.plc.knot_ring import KnotRing
from sim_plc.plc.path import REST_SPEED_MAX_RAD_S, RING_SIZE_KNOTS, advance, is_short_of_knots, ramp_down, stop_time
from sim_plc.plc.servo import Servo
from sim_plc.plc.settings import PlcSettings

_AT_END_S = 1e-9


class Motion(Enum):
    """What the reference does."""

    FOLLOW = "follow"  # not armed: it is where the joints are
    HOLD = "hold"
    PLAY = "play"
    PATH_STOP = "path stop"  # down to rest along the path
    JOINT_STOP = "joint stop"  # down to rest along the present direction of motion
    SERVO = "servo"  # chasing a target


class Reference:
    """q_ref, qd_ref, qdd_ref (n,) of the present cycle, and how they go on."""

    def __init__(self, settings: PlcSettings, ring: KnotRing) -> None:
        self._settings, self._ring = settings, ring
        self._out = np.zeros((3, settings.n))
        self._decel = np.zeros(settings.n)
        self._k, self._sigma, self._rate = 0, 0.0, 0.0
        # Longer than this no joint needs to stop, so a buffer this deep needs no look ahead
        slowest = max(axis.qd_max / axis.qdd_max for axis in settings.limit_table.axes)
        self._look_ahead_s = 2.0 * slowest
        self.servo = Servo(settings)
        self.fade = 1.0  # share of the controllers' output: goes to 0 over a ramp, so that the joints do not catch up
        self._fade_step = 0.0
        self.qd_joints = np.zeros(settings.n)  # what the encoders say, where they say anything
        self.motion = Motion.FOLLOW
        self.speed_override = 1.0

    @property
    def q(self) -> Array:
        """Position [rad]; a view that the next cycle changes."""
        return self._out[0]

    @property
    def qd(self) -> Array:
        """Velocity [rad/s]; a view that the next cycle changes."""
        return self._out[1]

    @property
    def qdd(self) -> Array:
        """Acceleration [rad/s2]; a view that the next cycle changes."""
        return self._out[2]

    @property
    def knot_playing(self) -> int:
        """Index of the knot that begins the segment being played; the last one's when the end is reached."""
        ring = self._ring
        return ring.end if ring.complete and self._at_path_end() else self._k

    @property
    def t_play_ns(self) -> int:
        """Time in the trajectory."""
        return round(self._sigma * 1e9)

    @property
    def path_left_s(self) -> float:
        """Trajectory time in the ring ahead of the playback [s]."""
        ring = self._ring
        return max(float(ring.times[ring.last % RING_SIZE_KNOTS]) - self._sigma, 0.0) if ring.last >= 0 else 0.0

    @property
    def buffer_s(self) -> float:
        """How long the reference still moves on without a new command [s]."""
        return self.servo.left_s if self.motion is Motion.SERVO else self.path_left_s

    @property
    def rate(self) -> float:
        """Trajectory seconds per second: 1 at full speed, 0 at rest."""
        return self._rate

    def follow_joints(self, q: Array) -> None:
        """Be where the joints are."""
        self.motion = Motion.FOLLOW
        self._hold_at(q)

    def let_go(self) -> None:
        """Stand still where it is, with no control: the joints cannot be followed, or will not be driven."""
        self.motion = Motion.FOLLOW
        self.fade = 1.0
        self._out[1:] = 0.0

    def hold_at(self, q: Array) -> None:
        """Stay at q."""
        self.motion = Motion.HOLD
        self._hold_at(q)

    def settle_at(self, q: Array) -> None:
        """A ramp is over: stay at q, where the joints are, with nothing left to catch up with."""
        self._rate = 0.0
        self.hold_at(q)

    def rewind(self) -> None:
        """Stand before knot 0 of a new trajectory."""
        self._k, self._sigma, self._rate = 0, 0.0, 0.0

    def play_from_start(self) -> None:
        """Start from knot 0; it is at rest, so starting at full rate is not a step."""
        self.rewind()
        self._rate = self.speed_override
        self.motion = Motion.PLAY

    def start_servo(self) -> None:
        """Chase the target that `servo` holds."""
        self.rewind()
        self.motion = Motion.SERVO

    def stop(self) -> None:
        """Ramp down with qdd_stop: along the path if that is as quick and the path is long enough, else straight on."""
        if self.motion is Motion.SERVO:
            self._stop_straight()
        if self.motion is not Motion.PLAY:
            return
        settings, ring = self._settings, self._ring
        bound_s = self._stop_bound_s() + settings.cycle_s
        self._begin_fade()
        needed_s = stop_time(
            ring.times, ring.knots, ring.last, self._k, self._sigma, self._rate, settings.cycle_s, settings.qdd_stop,
            bound_s,
        )  # fmt: skip
        if needed_s >= 0.0:
            self.motion = Motion.PATH_STOP
        else:
            self._stop_straight()

    def leave_path(self) -> None:
        """The path is about to be forgotten: a ramp on it goes on straight."""
        if self.motion is Motion.PATH_STOP:
            self._stop_straight()

    def stop_along_path(self) -> None:
        """Ramp down on what is left of the path."""
        if self.motion is Motion.PLAY:
            self._begin_fade()
            self.motion = Motion.PATH_STOP

    def quick_stop(self) -> None:
        """Every joint to rest by itself, as fast as its own limit allows."""
        if self.motion in (Motion.PLAY, Motion.PATH_STOP, Motion.JOINT_STOP, Motion.SERVO):
            self._begin_fade()
            self._decel[:] = self._settings.qdd_stop
            self.motion = Motion.JOINT_STOP

    def starving(self) -> bool:
        """Whether braking must begin now to be at rest before the last knot, the trajectory's end being unknown."""
        ring, settings = self._ring, self._settings
        if self.motion is not Motion.PLAY or ring.complete:
            return False
        if self.path_left_s > self._look_ahead_s:
            return False
        return is_short_of_knots(
            ring.times, ring.knots, ring.last, self._k, self._sigma, self._rate, self.speed_override,
            settings.cycle_s, settings.qdd_stop, 2.0 * self._look_ahead_s,
        )  # fmt: skip

    def step(self, t_plc_ns: int) -> bool:
        """Move on by one cycle; whether the motion is over (last knot or target reached, or at rest after a ramp)."""
        if self.motion is Motion.SERVO:
            return self.servo.step(self._out, self.speed_override, t_plc_ns)
        if self.motion is Motion.PLAY:
            self._advance_along_path(self.speed_override)
            return self._ring.complete and self._at_path_end()
        if self.motion in (Motion.PATH_STOP, Motion.JOINT_STOP):
            self.fade = max(self.fade - self._fade_step, 0.0)
            return self._step_stop_ramp() and self.fade == 0.0
        return False

    def _step_stop_ramp(self) -> bool:
        """One cycle of a ramp; whether the reference rests."""
        if self.motion is Motion.JOINT_STOP:
            return not ramp_down(self._out, self._decel, self._settings.cycle_s)
        self._advance_along_path(0.0)
        if self._rate > 0.0 and self._at_path_end() and float(np.abs(self.qd).max()) > REST_SPEED_MAX_RAD_S:
            self._stop_straight()  # a path that was cut short under the brake
            return False
        return self._rate == 0.0 or self._at_path_end()

    def settle(self) -> None:
        """Stay where the motion has reached its end."""
        self.motion = Motion.HOLD
        self._rate = 0.0
        self._out[1:] = 0.0

    def _stop_bound_s(self) -> float:
        """How long the slowest joint needs to rest with its full deceleration [s]."""
        return float(np.max(np.abs(self.qd) / self._settings.qdd_stop))

    def _begin_fade(self) -> None:
        """Fade the controllers out over the time that reference and joints need, or faster if they fade already."""
        believed = np.minimum(np.abs(self.qd_joints), PLAUSIBLE_SPEED_FACTOR * self._settings.qd_max)  # one raw reading
        joints_s = float(np.max(believed / self._settings.qdd_stop))
        step = self._settings.cycle_s / max(self._stop_bound_s(), joints_s, self._settings.cycle_s)
        self._fade_step = step if self.fade == 1.0 else max(step, self._fade_step)

    def _hold_at(self, q: Array) -> None:
        self.fade = 1.0
        np.copyto(self._out[0], q, where=np.isfinite(q))  # an encoder that says nothing leaves its joint where it was
        self._out[1:] = 0.0

    def _at_path_end(self) -> bool:
        return self.path_left_s <= _AT_END_S

    def _advance_along_path(self, target: float) -> None:
        ring, settings = self._ring, self._settings
        self._k, self._sigma, self._rate = advance(
            ring.times, ring.knots, ring.last, self._k, self._sigma, self._rate, target, settings.cycle_s,
            settings.qdd_stop, self._out,
        )  # fmt: skip

    def _stop_straight(self) -> None:
        """All joints to rest together; a joint that would leave its range that way brakes by its own limit."""
        settings = self._settings
        if self.fade == 1.0:
            self._begin_fade()
        duration_s = max(self._stop_bound_s(), settings.cycle_s)
        q_rest = self.q + 0.5 * self.qd * duration_s
        outside = (q_rest < settings.q_min) | (q_rest > settings.q_max)
        self._decel[:] = np.where(outside, settings.qdd_stop, np.abs(self.qd) / duration_s)
        self.motion = Motion.JOINT_STOP
