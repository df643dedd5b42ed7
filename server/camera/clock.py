"""Camera clock -> PC clock: stamp plus the smallest (receive - stamp), aged by the clocks' drift."""

from server.camera.smallest_offset import SmallestOffset, aged

STEP_NS = 50_000_000  # most by which pairs must all be later than the map before it follows a clock that was set back
STEP_PAIRS = 8


class CameraClock:
    """Maps exposure stamps to the PC's monotonic clock.

    Model:   offset = min over all pairs i of (receive_i - stamp_i + drift_max * age_i).
    Bound:   for a drift within +-100 ppm the mapped exposure is never earlier than the true one plus the camera's
             smallest latency, and later by at most min over the pairs of (latency_i - smallest + 2 * 100 ppm * age_i):
             with a pair of nearly the smallest latency every second, 0.2 ms plus what it lacks.
    Steps:   a clock that is set forward is followed at once. A picture that comes later than the map says is either
             of a clock that was set back, or old; taking the second for the first would make old pictures fresh. So
             the map becomes later only after stamps that fell short of the camera's usual step, by no more than they
             did, and from the 8th pair on (health forbids those pairs). What is not seen in the stamps, as a step of
             less than half a period, leaves the map early by as much, which ageing makes good at 100 ppm.
             A stamp that runs backwards once, out of order, changes nothing.
    """

    def __init__(self) -> None:
        self._smallest = SmallestOffset()
        self._connection = 0
        self._t_receive_ns = 0
        self._short_ns = 0  # by what stamps fell short, as long as it is not followed
        self._since: list[tuple[int, int]] = []  # (receive time, offset) from that pair on

    @property
    def offset_ns(self) -> int:
        """PC time minus camera time [ns] at the last pair; 0 before the first."""
        return self._smallest.at(self._t_receive_ns)

    def map(self, t_exposure_ns: int, t_receive_mono_ns: int, connection: int = 0, short_ns: int = 0) -> int:
        """The exposure on the PC's clock [ns]; a new connection starts afresh.

        `short_ns`: by how much this stamp came too soon after the one before, for the exposures between them.
        """
        offset_ns = t_receive_mono_ns - t_exposure_ns
        if connection != self._connection:
            self._smallest, self._connection, self._short_ns = SmallestOffset(), connection, 0
        self._t_receive_ns = t_receive_mono_ns
        self._smallest.learn(t_receive_mono_ns, offset_ns)
        if short_ns > 0:
            self._short_ns += short_ns
            self._since.clear()
        if self._short_ns > 0:
            self._since.append((t_receive_mono_ns, offset_ns))
            if len(self._since) == STEP_PAIRS:
                self._follow()
        return t_exposure_ns + self.offset_ns

    def _follow(self) -> None:
        """The clock was set back if every pair since then is later than the map."""
        now_ns = self._t_receive_ns
        later_ns = min(aged(*seen, now_ns) for seen in self._since) - self.offset_ns
        if later_ns > min(STEP_NS, self._short_ns // 2):
            self._smallest.begin(now_ns, self.offset_ns + min(later_ns, self._short_ns))
        self._short_ns = 0
        self._since.clear()
