"""Rate, loss, latency and jitter of a stream, by its stamps and their arrival. Pure: numbers in, findings out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.camera.check_findings import CheckFinding, Level, level_by_limits

Integers = NDArray[np.int64]

PAIRS_MIN = 5
RATE_WARN_HZ, RATE_FAIL_HZ = 10.0, 2.0  # odometry and looks want ten pairs a second
RATE_SHARE_WARN, RATE_SHARE_FAIL = 0.9, 0.5  # of the requested rate
LOSS_WARN_FRAC, LOSS_FAIL_FRAC = 0.01, 0.10
JITTER_WARN_S, JITTER_FAIL_S = 0.05, 0.25
LATENCY_WARN_S, LATENCY_FAIL_S = 0.15, 0.5
DRIFT_WARN_PPM = 500.0
DRIFT_DURATION_MIN_S = 5.0  # a shorter stream does not show the drift of the clocks
SAME_CLOCK_LATENCY_MAX_S = 2.0  # stamps this close behind arrival may be of this computer's own clock


@dataclass(frozen=True, slots=True, eq=False)
class StreamTimes:
    """Every pair that came: exposure and arrival [ns], sequence and connection numbers (n,); `n_skipped` by ourselves.

    `own_clock`: the source stamps with this computer's clock. `wanted_hz`: requested rate; None: any.
    `is_recorded`: played from files, whose arrival says nothing of a camera.
    """

    t_exposure_ns: Integers
    t_receive_ns: Integers
    sequence_numbers: Integers
    connection_numbers: Integers
    n_skipped: int = 0
    own_clock: bool = False
    wanted_hz: float | None = None
    is_recorded: bool = False


def check_stream(times: StreamTimes) -> list[CheckFinding]:
    """Findings `loss`, `stamps`, and of a live camera `rate`, `latency`; `stream` alone when too few pairs came."""
    n = len(times.t_receive_ns)
    if n < PAIRS_MIN:
        remedy = "check power, cable, address and that no other program holds the camera"
        return [
            CheckFinding("stream", Level.FAIL, f"{n} pairs came (at least {PAIRS_MIN})", remedy, {"pairs": float(n)})
        ]
    if times.is_recorded:
        return [_pair_loss_finding(times), _timestamp_finding(times)]
    return [_frame_rate_finding(times), _pair_loss_finding(times), _timestamp_finding(times), _latency_finding(times)]


def _frame_rate_finding(times: StreamTimes) -> CheckFinding:
    span_s = float(times.t_receive_ns[-1] - times.t_receive_ns[0]) * 1e-9
    rate_hz = (len(times.t_receive_ns) - 1) / span_s if span_s > 0.0 else 0.0
    level = level_by_limits(-rate_hz, -RATE_WARN_HZ, -RATE_FAIL_HZ)
    text = f"{rate_hz:.1f} pairs/s"
    if times.wanted_hz is not None:
        text += f" of {times.wanted_hz:g}"
        share = rate_hz / times.wanted_hz
        level = level_by_limits(-share, -RATE_SHARE_WARN, -RATE_SHARE_FAIL)
    remedy = "" if level is Level.OK else "shorten the exposure, use a faster port, or a smaller picture"
    return CheckFinding("rate", level, text, remedy, {"rate_hz": rate_hz})


def _pair_loss_finding(times: StreamTimes) -> CheckFinding:
    """Missing pairs by sequence numbers and by holes in the stamps, without those that we passed over ourselves."""
    missing = max(_missing_by_sequence(times), _missing_by_stamp(times))
    lost = max(0, missing - times.n_skipped)
    share = lost / (len(times.sequence_numbers) + missing)
    level = level_by_limits(share, LOSS_WARN_FRAC, LOSS_FAIL_FRAC)
    text = f"{lost} pairs lost ({100.0 * share:.1f} %), {times.n_skipped} passed over here"
    connections = len(np.unique(times.connection_numbers))
    if connections > 1:
        level = Level.FAIL if level is Level.FAIL else Level.WARN
        text += f", {connections - 1} times the stream broke"
    remedy = "" if level is Level.OK else "check cable and network load; use TCP and a wired link"
    return CheckFinding("loss", level, text, remedy, {"lost": float(lost), "loss_frac": share})


def _within_connections(times: StreamTimes, values: Integers) -> Integers:
    """Steps between successive values of one connection."""
    return np.diff(values)[np.diff(times.connection_numbers) == 0]


def _missing_by_sequence(times: StreamTimes) -> int:
    steps = _within_connections(times, times.sequence_numbers)
    return int(np.maximum(steps - 1, 0).sum())


def _missing_by_stamp(times: StreamTimes) -> int:
    steps = _within_connections(times, times.t_exposure_ns)
    steps = steps[steps > 0]
    if not len(steps):
        return 0
    return int(np.maximum(np.rint(steps / np.median(steps)) - 1, 0).sum())


def _timestamp_finding(times: StreamTimes) -> CheckFinding:
    steps = _within_connections(times, times.t_exposure_ns)
    backwards, standing = int((steps < 0).sum()), int((steps == 0).sum())
    figures = {"backwards": float(backwards), "standing": float(standing)}
    if backwards or standing:
        text = f"stamps run backwards {backwards} times and stand still {standing} times"
        remedy = "the camera is frozen or its clock is set while it runs: restart it, switch its time service off"
        return CheckFinding("stamps", Level.FAIL, text, remedy, figures)
    period_ms = float(np.median(steps)) * 1e-6 if len(steps) else 0.0
    spread_ms = float(np.percentile(np.abs(steps - np.median(steps)), 95)) * 1e-6 if len(steps) else 0.0
    text = f"advance by {period_ms:.2f} ms, 95 % within {spread_ms:.2f} ms"
    return CheckFinding("stamps", Level.OK, text, "", {**figures, "period_ms": period_ms, "spread_ms": spread_ms})


def _latency_finding(times: StreamTimes) -> CheckFinding:
    """From stamp to arrival where one clock made both; otherwise how much it varies, the clocks' drift taken out."""
    late_s = (times.t_receive_ns - times.t_exposure_ns).astype(float) * 1e-9
    if not late_s.any():
        text = "pairs are stamped on arrival: latency and jitter cannot be measured"
        remedy = "use a source that provides time stamps (X-Exposure-Ns, V4L2, RTSP)"
        return CheckFinding("latency", Level.WARN, text, remedy)
    t_s = (times.t_receive_ns - times.t_receive_ns[0]).astype(float) * 1e-9
    newest = times.connection_numbers == times.connection_numbers[-1]
    rest_s, drift_ppm = _without_drift(t_s[newest], late_s[newest])
    jitter_s = float(np.percentile(rest_s, 95) - rest_s.min())
    figures = {"jitter_p95_ms": 1e3 * jitter_s, "drift_ppm": drift_ppm}
    level = level_by_limits(jitter_s, JITTER_WARN_S, JITTER_FAIL_S)
    text = f"arrival varies by {1e3 * jitter_s:.1f} ms (95 %)"
    if times.own_clock and 0.0 <= late_s.min() < SAME_CLOCK_LATENCY_MAX_S:
        p50, p95 = (float(value) for value in np.percentile(late_s, (50, 95)))
        figures |= {"latency_p50_ms": 1e3 * p50, "latency_p95_ms": 1e3 * p95}
        text = f"latency {1e3 * p50:.1f} ms (95 %: {1e3 * p95:.1f} ms), {text}"
        level = max(level, level_by_limits(p95, LATENCY_WARN_S, LATENCY_FAIL_S), key=_severity_rank)
    else:
        text += "; the camera has a clock of its own, so the absolute latency cannot be measured"
    if abs(drift_ppm) > DRIFT_WARN_PPM:
        level = max(level, Level.WARN, key=_severity_rank)
        text += f"; the clocks drift by {drift_ppm:.0f} ppm"
    remedy = (
        ""
        if level is Level.OK
        else "reduce the load of network and computer; use a wired link; check the camera's clock"
    )
    return CheckFinding("latency", level, text, remedy, figures)


def _severity_rank(level: Level) -> int:
    return (Level.OK, Level.WARN, Level.FAIL).index(level)


def _without_drift(t_s: NDArray[np.float64], late_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Delays less the line under them (least of each tenth of the time), its slope [ppm]; 0 for a short stream."""
    if t_s[-1] - t_s[0] < DRIFT_DURATION_MIN_S:
        return late_s, 0.0
    parts = np.array_split(np.arange(len(t_s)), 10)
    lows = np.array([part[np.argmin(late_s[part])] for part in parts if len(part)])
    slope, _ = np.polyfit(t_s[lows], late_s[lows], 1)
    return late_s - slope * t_s, float(slope) * 1e6
