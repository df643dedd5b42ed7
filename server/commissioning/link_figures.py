"""How well states arrive, from the samples alone: rate, loss, gaps, delay and the drift of the clocks. Pure."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from machine.rotations import Array
from server.commissioning.contracts import Figure
from server.link.contracts import PlcSample

LOSS_MAX_PCT = 1.0
GAP_MAX_MS = 250.0  # the link counts as offline then, and a motion would be stopped
WAY_P99_MAX_MS = 50.0  # a command acknowledges states: the PLC refuses those older than 250 ms
DRIFT_MAX_PPM = 500.0  # usual quartz is below 100; motion does not depend on it, time stamps of pictures do
RATE_TOLERANCE_FRAC = 0.05
_BIN_S = 1.0


def state_figures(samples: Sequence[PlcSample], period_s: float) -> tuple[Figure, ...]:
    """Rate, loss, largest gap, spread of the way from PLC to PC, and clock drift.

    Args:    samples: as received, at least two seconds of them; period_s: of the PLC's states.
    Returns: the figures; NaN where the samples are too few, which is outside every limit.
    """
    rate, lost = 1.0 / period_s, lost_states(samples)
    nan = float("nan")
    if len(samples) < 2:
        return (Figure("states", float(len(samples)), "in all", at_least=2.0),)
    t_pc, t_plc = _seconds(samples)
    span_s = float(t_plc[-1] - t_plc[0])
    way_ms = 1e3 * _spread(t_pc - t_plc)
    return (
        Figure(
            "states on the PLC's clock",
            (len(samples) - 1 + lost) / span_s if span_s > 0.0 else nan,
            "1/s",
            at_least=rate * (1.0 - RATE_TOLERANCE_FRAC),
            at_most=rate * (1.0 + RATE_TOLERANCE_FRAC),
        ),
        Figure("states lost", 100.0 * lost / (len(samples) + lost), "%", None, LOSS_MAX_PCT),
        Figure("largest gap between states", 1e3 * float(np.diff(t_pc).max()), "ms", at_most=GAP_MAX_MS),
        Figure("latency PLC to PC above the minimum, median", float(np.median(way_ms)), "ms"),
        Figure(
            "latency PLC to PC above the minimum, 99 %", float(np.percentile(way_ms, 99)), "ms", None, WAY_P99_MAX_MS
        ),
        Figure("drift of the PLC's clock against the PC's", abs(drift_ppm(t_pc, t_plc)), "ppm", at_most=DRIFT_MAX_PPM),
    )


def lost_states(samples: Sequence[PlcSample]) -> int:
    """States missing between the first and the last sample; a new session begins to count anew."""
    steps = [after.seq - before.seq for before, after in pairwise(samples)]
    return sum(step - 1 for step in steps if step > 1)


def drift_ppm(t_pc: Array, t_plc: Array) -> float:
    """Rate of t_pc - t_plc [1e-6], from the quickest state of every second: delays only ever add.

    Args:    t_pc, t_plc: (n,) [s].
    Returns: drift; NaN with less than three seconds.
    """
    delay, bins = t_pc - t_plc, ((t_plc - t_plc[0]) // _BIN_S).astype(int)
    best = [np.flatnonzero(bins == number) for number in range(int(bins[-1]) + 1)]
    picked = [rows[np.argmin(delay[rows])] for rows in best if len(rows) >= 10]
    if len(picked) < 3:
        return float("nan")
    return float(np.polyfit(t_plc[picked] - t_plc[0], delay[picked], 1)[0]) * 1e6


def _seconds(samples: Sequence[PlcSample]) -> tuple[Array, Array]:
    """Receive and PLC times from the first sample on (n,) [s]."""
    first = samples[0]
    t_pc = np.array([sample.t_mono_ns - first.t_mono_ns for sample in samples]) * 1e-9
    t_plc = np.array([sample.t_plc_ns - first.t_plc_ns for sample in samples]) * 1e-9
    return t_pc, t_plc


def _spread(delay: Array) -> Array:
    return delay - delay.min()
