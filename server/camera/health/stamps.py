"""Do the camera's stamps go on as time does? Steady, forwards, and no faster than the pictures arrive."""

from collections import deque

from server.camera.contracts import StereoFrame
from server.camera.health.findings import FaultCode, Finding, Pair
from server.camera.smallest_offset import SmallestOffset

PERIOD_WINDOW_PAIRS = 120  # pairs over which the period is taken
STAMP_PERIOD_MIN_FRAC = 0.5  # a step shorter than this of the usual one is not the camera's
PERIOD_PAIRS_MIN = 8
STARTING_PAIRS = 8  # the first of a stream may have waited in a buffer: for no look, and lateness is learnt again
LATENCY_SETTLED_PAIRS = 30  # pairs after which the smallest latency is known well
STAMP_AHEAD_MAX_S = 0.100  # stamps ahead of their arrival by more, against the smallest latency seen: before that ...
STAMP_AHEAD_SETTLED_MAX_S = 0.025  # ... and from then on
FRAME_LATENESS_MAX_S = 0.5  # a picture this much later than the fastest is old, or its stamp is
SILENCE_MAX_S = 0.5


class StampMonitor:
    """Stamps against each other and against their arrival.

    `short_ns`: by how much the last stamp came too soon after the one before: what a clock was set back by, at most.
    """

    def __init__(self) -> None:
        self.short_ns = 0
        self._begin(None)

    def _begin(self, before: StereoFrame | None) -> None:
        self._before = before
        self._seen = 0  # of this connection
        self._periods_ns: deque[int] = deque(maxlen=PERIOD_WINDOW_PAIRS)
        self._smallest = SmallestOffset()
        self._learnt = 0  # offsets since it began, or since its clock was set

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Compare with the pair before; after a clock was set, periods are learnt again."""
        frame, before = pair.frame, self._before
        self.short_ns = 0
        fresh = before is None or before.connection_number != frame.connection_number
        if fresh:
            self._begin(before)
        found = [
            found
            for found in (self._compare_with_previous(frame, before, fresh), self._new_connection_finding(frame))
            if found is not None
        ]
        self._before = frame
        return tuple(found)

    def _compare_with_previous(self, frame: StereoFrame, before: StereoFrame | None, fresh: bool) -> Finding | None:
        if before is None or (fresh and before.t_exposure_ns != frame.t_exposure_ns):
            self._learn_offset_and_period(frame, None)
            return None
        finding = self._stamp_step_finding(before, frame)
        if finding is not None and finding.code is FaultCode.STAMP_STANDS:
            return finding  # nothing to learn from
        finding = finding or self._arrival_delay_finding(frame)
        if finding is None:
            self._learn_offset_and_period(
                frame, (frame.t_exposure_ns - before.t_exposure_ns) // _exposures_between(before, frame)
            )
            return None
        self._periods_ns.clear()  # a camera that was short of time and is so no longer is faster from now on
        if finding.code is not FaultCode.LATE:  # a picture that is old says nothing of the clock
            self._clock_was_set(frame)
        return finding

    def _new_connection_finding(self, frame: StereoFrame) -> Finding | None:
        """A line that was opened just now may give pictures that waited in a buffer, or the last one for ever."""
        self._seen += 1
        if frame.connection_number == 0 or self._seen > STARTING_PAIRS:
            return None
        text = f"picture {self._seen} of a new connection: the first {STARTING_PAIRS} may have waited in a buffer; wait"
        return Finding(FaultCode.STARTING, text, forbids_odometry=False)

    def _learn_offset_and_period(self, frame: StereoFrame, period_ns: int | None) -> None:
        self._smallest.learn(frame.t_receive_mono_ns, frame.t_receive_mono_ns - frame.t_exposure_ns)
        self._learnt += 1
        if period_ns is not None:
            self._periods_ns.append(period_ns)

    def _clock_was_set(self, frame: StereoFrame) -> None:
        """By no more than its stamps fell short: a picture may be late besides."""
        now_ns = frame.t_receive_mono_ns
        most_ns = self._smallest.offset_at(now_ns) + self.short_ns
        self._smallest.begin(now_ns, min(now_ns - frame.t_exposure_ns, most_ns))
        self._learnt = 1

    def _stamp_step_finding(self, before: StereoFrame, frame: StereoFrame) -> Finding | None:
        step_ns = frame.t_exposure_ns - before.t_exposure_ns
        if step_ns == 0:
            text = "camera frozen: its stamp does not advance; restart the camera"
            return Finding(FaultCode.STAMP_STANDS, text)
        if step_ns < 0:
            self.short_ns = -step_ns + self._usual_ns(before, frame)
            text = f"camera stamps run backwards by {-step_ns / 1e6:.1f} ms; its clock was set: restart the stream"
            return Finding(FaultCode.STAMP_BACKWARDS, text)
        if len(self._periods_ns) < PERIOD_PAIRS_MIN:
            return None
        usual_ns = self._usual_ns(before, frame)
        if step_ns < STAMP_PERIOD_MIN_FRAC * usual_ns:
            self.short_ns = usual_ns - step_ns
            text = (
                f"camera stamps jumped: a step of {step_ns / 1e6:.1f} ms where {usual_ns / 1e6:.1f} ms are usual "
                f"(limit {STAMP_PERIOD_MIN_FRAC * usual_ns / 1e6:.1f} ms): its clock was set, or it is faster from now "
                "on; restart the stream if this stays"
            )
            return Finding(FaultCode.STAMP_JUMPED, text)
        return None

    def _usual_ns(self, before: StereoFrame, frame: StereoFrame) -> int:
        """From one to the other as the last ones came; 0 while too few are known."""
        if len(self._periods_ns) < PERIOD_PAIRS_MIN:
            return 0
        return sorted(self._periods_ns)[len(self._periods_ns) // 2] * _exposures_between(before, frame)

    def _arrival_delay_finding(self, frame: StereoFrame) -> Finding | None:
        now_ns = frame.t_receive_mono_ns
        later_s = (now_ns - frame.t_exposure_ns - self._smallest.offset_at(now_ns)) * 1e-9
        ahead_max_s = STAMP_AHEAD_SETTLED_MAX_S if self._learnt >= LATENCY_SETTLED_PAIRS else STAMP_AHEAD_MAX_S
        if -later_s > ahead_max_s and self._learnt < STARTING_PAIRS:
            self._learnt = 0
            return None
        if -later_s > ahead_max_s:
            text = (
                f"camera stamps jumped ahead of their arrival by {-1e3 * later_s:.0f} ms (limit "
                f"{1e3 * ahead_max_s:.0f} ms); its clock was set: restart the stream if this comes again"
            )
            return Finding(FaultCode.STAMP_JUMPED, text)
        if later_s > FRAME_LATENESS_MAX_S:
            text = (
                f"picture is {1e3 * later_s:.0f} ms older than the fastest (limit {1e3 * FRAME_LATENESS_MAX_S:.0f} "
                "ms); the network or this computer is overloaded, or the camera's clock was set: restart the stream if "
                "it stays"
            )
            return Finding(FaultCode.LATE, text)
        return None


def _exposures_between(before: StereoFrame, frame: StereoFrame) -> int:
    """Exposures from one to the other, those passed over counted; 1 for a camera whose count does not go on."""
    return max(1, frame.sequence - before.sequence)


def silence_text(t_last_receive_mono_ns: int, t_now_mono_ns: int) -> tuple[Finding, ...]:
    """What to say when no pair has come for a while; the pairs before it are not to be used any more."""
    silent_s = (t_now_mono_ns - t_last_receive_mono_ns) * 1e-9
    if silent_s <= SILENCE_MAX_S:
        return ()
    text = f"no image for {silent_s:.1f} s (limit {SILENCE_MAX_S:g} s); check the camera, its power and its cable"
    return (Finding(FaultCode.SILENT, text),)
