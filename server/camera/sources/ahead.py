"""Decodes the next pair while the one before is still being worked on, and no earlier than that takes."""

import threading
from collections import deque

from recording.clock import mono_s
from server.camera.contracts import StereoFrame, StereoSource

READ_TIMEOUT_S = 0.1  # how soon the thread hears that it shall end
TIMING_HISTORY_PAIRS = 30  # pairs whose times predict the next one's
# Times the shortest decoding: a little early is a pair a little older, late is a pair less
DECODE_HEADSTART_FACTOR = 2.0


class AheadSource:
    """Wraps a camera. A thread holds one pair ready; a camera's pairs that are passed over still cost nothing.

    A pair that waits grows old, so the thread begins with the newest one only shortly before the worker is expected
    back, by the times that the last pairs took it. A worker that comes back earlier wakes the thread immediately.
    """

    def __init__(self, source: StereoSource) -> None:
        self._source = source
        self._changed = threading.Condition()
        self._ready: StereoFrame | None = None
        self._failure: Exception | None = None
        self._wanted, self._stop = True, False
        self._taken_s = mono_s()
        self._working_s: deque[float] = deque(maxlen=TIMING_HISTORY_PAIRS)
        self._decoding_s: deque[float] = deque(maxlen=TIMING_HISTORY_PAIRS)
        self._thread = threading.Thread(target=self._run, name="camera-ahead", daemon=True)
        self._thread.start()

    @property
    def skipped(self) -> int:
        """Pairs passed over so far because newer ones were there."""
        return self._source.skipped

    @property
    def state(self) -> str:
        """The camera's."""
        return self._source.state

    @property
    def ended(self) -> bool:
        """Whether no pair will ever come again."""
        return self._ready is None and self._source.ended

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The next pair; None when none came in time.

        Raises: what the camera's own read raised, once.
        """
        with self._changed:
            if not self._wanted:
                self._working_s.append(mono_s() - self._taken_s)
                self._wanted = True
                self._changed.notify_all()
            self._changed.wait_for(lambda: self._ready is not None or self._failure is not None, timeout_s)
            if self._failure is not None:
                failure, self._failure = self._failure, None
                self._changed.notify_all()
                raise failure
            frame, self._ready = self._ready, None
            if frame is not None:
                self._taken_s, self._wanted = mono_s(), False
                self._changed.notify_all()
            return frame

    def close(self) -> None:
        """End the thread, let go of the camera."""
        with self._changed:
            self._stop = True
            self._changed.notify_all()
        self._source.close()
        self._thread.join(2.0 * READ_TIMEOUT_S + 1.0)

    def _run(self) -> None:
        while self._wait_until_due():
            began_s = mono_s()
            try:
                frame, failure = self._source.read(READ_TIMEOUT_S), None
            except Exception as error:  # the worker's to deal with, as if it had read the camera itself
                frame, failure = None, error
            with self._changed:
                if frame is not None:
                    self._decoding_s.append(mono_s() - began_s)
                self._ready, self._failure = frame, failure
                self._changed.notify_all()

    def _wait_until_due(self) -> bool:
        """Wait until a pair is due; False at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._stop or (self._ready is None and self._failure is None))
            left_s = self._taken_s + self._expected_s() - mono_s()
            self._changed.wait_for(lambda: self._stop or self._wanted, max(0.0, left_s))
            return not self._stop

    def _expected_s(self) -> float:
        """From taking a pair until the next one should be begun [s].

        The shortest decoding counts: the other ones waited for the camera, too.
        """
        if not self._working_s:
            return 0.0
        working_s = sorted(self._working_s)[len(self._working_s) // 2]
        return max(0.0, working_s - DECODE_HEADSTART_FACTOR * min(self._decoding_s, default=0.0))
