"""PLC-to-PC clock offset from the echo's four time stamps; the fastest round trips weigh most."""

from collections import deque
from dataclasses import dataclass, field

_BUCKET_NS = 1_000_000_000
_BUCKETS = 30  # half a minute: at 50 ppm the clocks drift apart by 1.5 ms in it


@dataclass(frozen=True, slots=True)
class _Best:
    second: int
    delay_ns: int
    offset_ns: int


@dataclass(slots=True)
class ClockOffset:
    """Minimum-delay filter: the best exchange of every second, the best of half a minute counts."""

    delay_ns: int = 0  # newest round trip without the time spent in the PLC
    _best: deque[_Best] = field(default_factory=lambda: deque(maxlen=_BUCKETS))

    def add(self, t_pc_send_ns: int, t_plc_receive_ns: int, t_plc_send_ns: int, t_pc_receive_ns: int) -> None:
        """One exchange: command sent, command accepted, state sent, state received; each on its own end's clock.

        Model: delay = (t4 - t1) - (t3 - t2), offset = ((t1 - t2) + (t4 - t3)) / 2 with t_pc = t_plc + offset.
        Source: RFC 5905, section 8.
        """
        self.delay_ns = (t_pc_receive_ns - t_pc_send_ns) - (t_plc_send_ns - t_plc_receive_ns)
        offset_ns = ((t_pc_send_ns - t_plc_receive_ns) + (t_pc_receive_ns - t_plc_send_ns)) // 2
        second = t_pc_receive_ns // _BUCKET_NS
        if not self._best or self._best[-1].second != second:
            self._best.append(_Best(second, self.delay_ns, offset_ns))
        elif self.delay_ns < self._best[-1].delay_ns:
            self._best[-1] = _Best(second, self.delay_ns, offset_ns)

    @property
    def delay_min_ns(self) -> int:
        """The quickest round trip of the last half minute; 0 before the first exchange."""
        return min((best.delay_ns for best in self._best), default=0)

    @property
    def offset_ns(self) -> int | None:
        """t_pc = t_plc + offset; None before the first exchange."""
        return min(self._best, key=lambda best: best.delay_ns).offset_ns if self._best else None
