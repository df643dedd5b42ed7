"""The smallest (receive - stamp) so far: offset of the camera's clock to this computer's, plus its smallest latency."""

DRIFT_MAX_PPM = 100.0  # of the camera against this computer; quartz clocks keep 50 each


class SmallestOffset:
    """What was read earlier may be off by the drift since, and is made later by as much.

    So it is forgotten as fast as clocks drift and no faster: a line that gets slow does so faster, and stays apart.
    """

    def __init__(self) -> None:
        self._read: tuple[int, int] | None = None  # receive time, offset

    @property
    def is_known(self) -> bool:
        """Whether a pair was seen."""
        return self._read is not None

    def offset_at(self, t_receive_ns: int) -> int:
        """The offset as it may be by then [ns]; 0 before the first pair."""
        if self._read is None:
            return 0
        t_read_ns, offset_ns = self._read
        return aged_offset(t_read_ns, offset_ns, t_receive_ns)

    def learn(self, t_receive_ns: int, offset_ns: int) -> None:
        """Take in one pair's."""
        if self._read is None or offset_ns < self.offset_at(t_receive_ns):
            self._read = t_receive_ns, offset_ns

    def begin(self, t_receive_ns: int, offset_ns: int) -> None:
        """From now on it is this one."""
        self._read = t_receive_ns, offset_ns


def aged_offset(t_read_ns: int, offset_ns: int, t_now_ns: int) -> int:
    """An offset read at `t_read_ns`, as it may be by now [ns]."""
    return offset_ns + round(DRIFT_MAX_PPM * 1e-6 * max(t_now_ns - t_read_ns, 0))
