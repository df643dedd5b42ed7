"""The last three minutes of PLC samples, and who wants to hear of new ones."""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable

from server.link.contracts import PlcSample
from server.listeners import Listeners

_KEPT = 180 * 100  # three minutes at 100 Hz: the longest calibration path fits

SampleCallback = Callable[[PlcSample], None]


class SampleRing:
    """Samples in the order of their receive time."""

    def __init__(self) -> None:
        self._samples: deque[PlcSample] = deque(maxlen=_KEPT)
        self.listeners = Listeners[[PlcSample]]("a PLC sample")

    @property
    def latest(self) -> PlcSample | None:
        """The newest sample."""
        return self._samples[-1] if self._samples else None

    def extend(self, samples: Iterable[PlcSample]) -> None:
        """Keep new samples and tell everybody."""
        for sample in samples:
            self._samples.append(sample)
            self.listeners.call(sample)

    def since(self, t_mono_ns: int) -> list[PlcSample]:
        """All samples received after this time."""
        kept = list(self._samples)
        return kept[bisect_right(kept, t_mono_ns, key=lambda sample: sample.t_mono_ns) :]

    def subscribe(self, callback: SampleCallback) -> Callable[[], None]:
        """Call back for every new sample; the answer ends it."""
        return self.listeners.add(callback)
