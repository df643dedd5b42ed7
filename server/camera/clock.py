"""Camera clock -> PC clock: stamp plus the smallest (receive - stamp) of a window, aged by the clocks' drift."""

from collections import deque

JUMP_NS = 1_000_000_000  # a step of the offset beyond this means a new clock, not latency
DRIFT_MAX_PPM = 100.0  # of the camera against this computer; quartz clocks keep 50 each
STEP_NS = 50_000_000  # all of the last pairs later than the map by more than this: the camera's clock was set back
STEP_PAIRS = 8


class CameraClock:
    """Maps exposure stamps to the PC's monotonic clock.

    Model:   offset = min over the window of (receive_i - stamp_i + drift_max * age_i). What was read `age` ago may be
             off by the drift since, and is made later by as much.
    Bound:   for a drift within +-100 ppm the mapped exposure is never earlier than the true one plus the camera's
             smallest latency, and later by at most min over the window of (latency_i - smallest + 2 * 100 ppm * age_i):
             with a pair of nearly the smallest latency every second, 0.2 ms plus what it lacks. After the camera's
             clock is set forward it holds at once; set back by more than 50 ms, from the 8th pair on (until then the
             mapped time is early by the step; health forbids those pairs); by less than 50 ms, when the window has
             passed. A stamp that runs backwards once, out of order, changes nothing.
    """

    def __init__(self, window_s: float) -> None:
        self._window_ns = int(window_s * 1e9)
        self._minima: deque[tuple[int, int]] = deque()  # (receive time, offset), aged offsets rising
        self._last: deque[tuple[int, int]] = deque(maxlen=STEP_PAIRS)
        self._connection = 0

    @property
    def offset_ns(self) -> int:
        """PC time minus camera time [ns] at the last pair; 0 before the first."""
        return self._aged(*self._minima[0], self._last[-1][0]) if self._minima else 0

    def map(self, t_exposure_ns: int, t_receive_mono_ns: int, connection: int = 0) -> int:
        """The exposure on the PC's clock [ns]; a new connection or a jump of the camera's clock starts afresh."""
        offset_ns = t_receive_mono_ns - t_exposure_ns
        if connection != self._connection or (self._minima and abs(offset_ns - self.offset_ns) > JUMP_NS):
            self._minima.clear()
            self._last.clear()
            self._connection = connection
        self._last.append((t_receive_mono_ns, offset_ns))
        self._insert(t_receive_mono_ns, offset_ns)
        if self._was_set_back():
            self._minima.clear()
            for seen in self._last:
                self._insert(*seen)
        while self._minima[0][0] < t_receive_mono_ns - self._window_ns:
            self._minima.popleft()
        return t_exposure_ns + self.offset_ns

    @staticmethod
    def _aged(t_receive_ns: int, offset_ns: int, t_now_ns: int) -> int:
        """An offset read at `t_receive_ns`, as it may be by now."""
        return offset_ns + round(DRIFT_MAX_PPM * 1e-6 * max(t_now_ns - t_receive_ns, 0))

    def _insert(self, t_receive_ns: int, offset_ns: int) -> None:
        """Keep the offsets that may yet be the smallest: all age alike, so what is larger now stays larger."""
        while self._minima and self._aged(*self._minima[-1], t_receive_ns) >= offset_ns:
            self._minima.pop()
        self._minima.append((t_receive_ns, offset_ns))

    def _was_set_back(self) -> bool:
        if len(self._last) < STEP_PAIRS:
            return False
        t_now_ns = self._last[-1][0]
        recent_ns = min(self._aged(*seen, t_now_ns) for seen in self._last)
        return recent_ns - self.offset_ns > STEP_NS
