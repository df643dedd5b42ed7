"""The target of servo mode as the PC keeps it between the caller's updates."""

from dataclasses import dataclass

from protocol.limits import LimitTable
from protocol.messages import ZEROS, Axes, Knot
from protocol.timeouts import SERVO_LOST_TIMEOUT, SERVO_STALE_TIMEOUT


@dataclass(slots=True)
class ServoTarget:
    """Where the reference shall go, as given at `t_set_ns` (PC clock); `ending`: there it shall stay."""

    traj_id: int
    q: Axes
    qd: Axes = ZEROS
    t_set_ns: int = 0
    ending: bool = False

    def set(self, q: Axes, qd: Axes, t_mono_ns: int) -> None:
        """A new target and its speed."""
        self.q, self.qd, self.t_set_ns = q, qd, t_mono_ns

    def age_ns(self, t_mono_ns: int) -> int:
        """Time since the caller's last word."""
        return t_mono_ns - self.t_set_ns

    def is_caller_silent(self, t_mono_ns: int) -> bool:
        """Whether the caller has been silent for too long."""
        return not self.ending and self.age_ns(t_mono_ns) > SERVO_LOST_TIMEOUT.duration_ns

    def knot(self, t_mono_ns: int, table: LimitTable) -> Knot:
        """The target now: moved on with its speed for at most 60 ms after the last update, then standing still."""
        age_s = min(self.age_ns(t_mono_ns), SERVO_STALE_TIMEOUT.duration_ns) * 1e-9
        stale = self.ending or self.age_ns(t_mono_ns) >= SERVO_STALE_TIMEOUT.duration_ns
        ahead = tuple(x + v * age_s for x, v in zip(self.q, self.qd, strict=True))
        inside = tuple(min(max(x, axis.q_min), axis.q_max) for x, axis in zip(ahead, table.axes, strict=False))
        return Knot(0, (*inside, *ahead[len(inside) :]), ZEROS if stale else self.qd)
