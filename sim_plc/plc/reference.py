"""Where the reference comes from: playback of the ring on the PLC's clock, or a ramp to rest."""

from dataclasses import dataclass, field
from enum import Enum

from protocol.messages import Knot
from sim_plc.plc.quintic import Quintic, Vector, quintic_between
from sim_plc.plc.ring import KnotRing


class PlaybackStatus(Enum):
    """How far the playback is."""

    PLAYING = "playing"
    ENDED = "ended"
    UNDERRUN = "underrun"


@dataclass(slots=True)
class RingPlayback:
    """Plays the ring's trajectory; `t_play_ns` is time in the trajectory."""

    ring: KnotRing
    t_play_ns: int = 0
    playing: int = 0
    _segment: tuple[int, Quintic] | None = field(default=None)

    def restart(self) -> None:
        """Stand before knot 0."""
        self.t_play_ns, self.playing, self._segment = 0, 0, None

    @property
    def buffer_ns(self) -> int:
        """Trajectory time in the ring ahead of the playback."""
        last = self.ring.knots.get(self.ring.last)
        return max(0, last.t_ns - self.t_play_ns) if last else 0

    def advance(self, dt_ns: int, n: int) -> tuple[PlaybackStatus, Vector, Vector]:
        """Move on by dt and give q_ref, qd_ref; at an underrun they are those of the last moment inside the ring."""
        ring = self.ring
        wanted = self.t_play_ns + dt_ns
        while self.playing < ring.last and wanted >= ring.knots[self.playing + 1].t_ns:
            self.playing += 1
        here = ring.knots[self.playing]
        if self.playing == ring.last:
            self.t_play_ns = here.t_ns
            status = PlaybackStatus.ENDED if ring.end == ring.last else PlaybackStatus.UNDERRUN
            return status, list(here.q[:n]), list(here.qd[:n])
        self.t_play_ns = wanted
        ring.forget_before(self.playing)
        q, qd, _ = self._quintic(here, n).at((wanted - here.t_ns) * 1e-9)
        return PlaybackStatus.PLAYING, q, qd

    def _quintic(self, here: Knot, n: int) -> Quintic:
        if self._segment is None or self._segment[0] != self.playing:
            self._segment = (self.playing, quintic_between(here, self.ring.knots[self.playing + 1], n))
        return self._segment[1]


@dataclass(frozen=True, slots=True)
class Ramp:
    """All joints to rest together, along the straight line of their present velocity: no step in qd_ref.

    duration = max |qd| / qdd_stop over the joints; q(t) = q0 + qd0 (t - t^2 / (2 duration)).
    """

    q0: tuple[float, ...]
    qd0: tuple[float, ...]
    t0_ns: int
    duration_s: float

    def at(self, t_ns: int) -> tuple[bool, Vector, Vector]:
        """Whether at rest, q_ref and qd_ref."""
        t = min((t_ns - self.t0_ns) * 1e-9, self.duration_s)
        if self.duration_s <= 0.0:
            return True, list(self.q0), [0.0] * len(self.q0)
        left = 1.0 - t / self.duration_s
        travel = t - 0.5 * t * t / self.duration_s
        q = [q + qd * travel for q, qd in zip(self.q0, self.qd0, strict=True)]
        return left <= 0.0, q, [qd * left for qd in self.qd0]


def ramp_from(q: Vector, qd: Vector, t_ns: int, qdd_stop: tuple[float, ...]) -> Ramp:
    """The ramp that starts now."""
    duration = max(abs(speed) / stop for speed, stop in zip(qd, qdd_stop, strict=True))
    return Ramp(tuple(q), tuple(qd), t_ns, duration)
