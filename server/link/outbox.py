"""Reports on their way to the server: a thread writes the pipe, so that a busy server never holds up the link."""

import threading
from collections import deque
from multiprocessing.connection import Connection

from server.link.contracts import HealthReport, LinkReport, PlcSample, SamplesReport

_SAMPLES_MAX = 3000  # half a minute of a stalled server


class Outbox:
    """What waits while the server does not read: the newest samples (others are dropped, counted), of health reports
    in a row the newest one, and every other report: each answers a request of the server, which sends none then.
    """

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.Condition()
        self._samples: deque[PlcSample] = deque()
        self._reports: deque[LinkReport] = deque()
        self._dropped = 0
        self.broken = False
        threading.Thread(target=self._work, name="link-outbox", daemon=True).start()

    def add_sample(self, sample: PlcSample) -> None:
        """Queue a sample; `flush` sends what has gathered."""
        with self._lock:
            if len(self._samples) >= _SAMPLES_MAX:
                self._samples.popleft()
                self._dropped += 1
            self._samples.append(sample)

    def report(self, report: LinkReport) -> None:
        """Send a report, after the samples that came before it."""
        with self._lock:
            if isinstance(report, HealthReport) and self._reports and isinstance(self._reports[-1], HealthReport):
                self._reports.pop()
            self._reports.append(report)
            self._lock.notify()

    def flush(self) -> None:
        """Send the gathered samples."""
        with self._lock:
            self._lock.notify()

    def _take(self) -> list[LinkReport]:
        with self._lock:
            while not self._samples and not self._reports:
                self._lock.wait()
            taken: list[LinkReport] = []
            if self._samples:
                taken.append(SamplesReport(tuple(self._samples), self._dropped))
            taken += self._reports
            self._samples.clear()
            self._reports.clear()
            return taken

    def _work(self) -> None:
        try:
            while True:
                for report in self._take():
                    self._pipe.send(report)
        except (OSError, ValueError):  # the server is gone, or the pipe was closed on leaving
            self.broken = True
