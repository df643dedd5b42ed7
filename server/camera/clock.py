"""Camera clock -> PC clock: stamp plus the smallest (receive - stamp) of a sliding window."""

from collections import deque

JUMP_NS = 1_000_000_000  # a step of the offset beyond this means a new clock, not latency


class CameraClock:
    """Maps exposure stamps to the PC's monotonic clock; late by the smallest latency in the window, never early."""

    def __init__(self, window_s: float) -> None:
        self._window_ns = int(window_s * 1e9)
        self._minima: deque[tuple[int, int]] = deque()  # (receive time, offset), offsets rising
        self._connection = 0

    @property
    def offset_ns(self) -> int:
        """PC time minus camera time [ns]; 0 before the first frame."""
        return self._minima[0][1] if self._minima else 0

    def map(self, t_exposure_ns: int, t_receive_mono_ns: int, connection: int = 0) -> int:
        """The exposure on the PC's clock [ns]; a new connection or a jump of the camera's clock starts afresh."""
        offset_ns = t_receive_mono_ns - t_exposure_ns
        if connection != self._connection or (self._minima and abs(offset_ns - self.offset_ns) > JUMP_NS):
            self._minima.clear()
            self._connection = connection
        while self._minima and self._minima[-1][1] >= offset_ns:
            self._minima.pop()
        self._minima.append((t_receive_mono_ns, offset_ns))
        while self._minima[0][0] < t_receive_mono_ns - self._window_ns:
            self._minima.popleft()
        return t_exposure_ns + self.offset_ns
