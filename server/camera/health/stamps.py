"""Do the camera's stamps go on as time does? Steady, forwards, and no faster than the pictures arrive."""

from collections import deque

from server.camera.contracts import StereoFrame
from server.camera.health.findings import FaultCode, Finding
from server.camera.health.pair import Pair

WINDOW = 120  # pairs over which the smallest latency and the period are taken
PERIOD_MIN_FRAC = 0.5  # a step shorter than this of the usual one is none of the camera's
PERIOD_KNOWN_FROM = 8
STARTING_PAIRS = 8  # the first pictures of a stream may have waited in a buffer: until then lateness is learnt anew
AHEAD_SETTLED_FROM = 30  # pairs after which the smallest latency is known well
AHEAD_MAX_S = 0.100  # stamps ahead of their arrival by more, against the smallest latency seen: before that ...
AHEAD_SETTLED_MAX_S = 0.025  # ... and from then on
LATE_MAX_S = 0.5  # a picture this much later than the fastest is old, or its stamp is
SILENCE_MAX_S = 0.5


class StampMonitor:
    """Stamps against each other and against their arrival."""

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._before: StereoFrame | None = None
        self._periods_ns: deque[int] = deque(maxlen=WINDOW)
        self._offsets_ns: deque[int] = deque(maxlen=WINDOW)

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Compare with the pair before; after a jump everything is learnt anew."""
        frame, before = pair.frame, self._before
        if before is None or before.connection != frame.connection:
            self._forget()
            self._learn(frame, None)
            return ()
        finding = self._step(before, frame)
        arrival = self._arrival(frame) if finding is None else None
        if finding is None and arrival is None:
            self._learn(frame, (frame.t_exposure_ns - before.t_exposure_ns) // _periods(before, frame))
            return ()
        moved_ns = frame.t_exposure_ns - before.t_exposure_ns
        if finding is not None and finding.code is FaultCode.STAMP_STANDS:
            self._before = frame  # nothing to learn from
        elif finding is not None or (arrival is not None and arrival.code is FaultCode.STAMP_JUMPED and moved_ns > 0):
            self._offsets_ns.clear()
            self._periods_ns.clear()  # a camera that was short of time and is so no longer is faster from now on
            self._learn(frame, None)
        found = finding or arrival
        return () if found is None else (found,)

    def _learn(self, frame: StereoFrame, period_ns: int | None) -> None:
        self._before = frame
        self._offsets_ns.append(frame.t_receive_mono_ns - frame.t_exposure_ns)
        if period_ns is not None:
            self._periods_ns.append(period_ns)

    def _step(self, before: StereoFrame, frame: StereoFrame) -> Finding | None:
        step_ns = frame.t_exposure_ns - before.t_exposure_ns
        if step_ns == 0:
            text = "camera frozen: its stamp does not advance; restart the camera"
            return Finding(FaultCode.STAMP_STANDS, text)
        if step_ns < 0:
            text = f"camera stamps run backwards by {-step_ns / 1e6:.1f} ms; its clock was set: restart the stream"
            return Finding(FaultCode.STAMP_BACKWARDS, text)
        if len(self._periods_ns) < PERIOD_KNOWN_FROM:
            return None
        usual_ns = sorted(self._periods_ns)[len(self._periods_ns) // 2]
        usual_ns *= _periods(before, frame)
        if step_ns < PERIOD_MIN_FRAC * usual_ns:
            text = (
                f"camera stamps jumped: a step of {step_ns / 1e6:.1f} ms where {usual_ns / 1e6:.1f} ms are usual "
                f"(limit {PERIOD_MIN_FRAC * usual_ns / 1e6:.1f} ms): its clock was set, or it is faster from now on; "
                "restart the stream if this stays"
            )
            return Finding(FaultCode.STAMP_JUMPED, text)
        return None

    def _arrival(self, frame: StereoFrame) -> Finding | None:
        if not self._offsets_ns:
            return None
        later_s = (frame.t_receive_mono_ns - frame.t_exposure_ns - min(self._offsets_ns)) * 1e-9
        ahead_max_s = AHEAD_SETTLED_MAX_S if len(self._offsets_ns) >= AHEAD_SETTLED_FROM else AHEAD_MAX_S
        if -later_s > ahead_max_s and len(self._offsets_ns) < STARTING_PAIRS:
            self._offsets_ns.clear()
            return None
        if -later_s > ahead_max_s:
            text = (
                f"camera stamps jumped ahead of their arrival by {-1e3 * later_s:.0f} ms (limit "
                f"{1e3 * ahead_max_s:.0f} ms); its clock was set: restart the stream if this comes again"
            )
            return Finding(FaultCode.STAMP_JUMPED, text)
        if later_s > LATE_MAX_S:
            text = (
                f"picture is {1e3 * later_s:.0f} ms older than the fastest (limit {1e3 * LATE_MAX_S:.0f} ms); the "
                "network or this computer is overloaded, or the camera's clock was set"
            )
            return Finding(FaultCode.STAMP_JUMPED, text)
        return None


def _periods(before: StereoFrame, frame: StereoFrame) -> int:
    """Exposures from one to the other, those passed over counted; 1 for a camera whose count does not go on."""
    return max(1, frame.sequence - before.sequence)


def silence(t_last_receive_mono_ns: int, t_now_mono_ns: int) -> tuple[Finding, ...]:
    """What to say when no pair has come for a while; the pairs before it are not to be used any more."""
    silent_s = (t_now_mono_ns - t_last_receive_mono_ns) * 1e-9
    if silent_s <= SILENCE_MAX_S:
        return ()
    text = f"no picture for {silent_s:.1f} s (limit {SILENCE_MAX_S:g} s); check the camera, its power and its cable"
    return (Finding(FaultCode.SILENT, text),)
