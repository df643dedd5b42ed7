"""The link: datagrams sent every 10 ms, arriving late, lost or rounded; the PLC holds the last one."""

import numpy as np

from benchmarks.diagnosis.sealed import faults as f
from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.faults import Faults
from machine.rotations import Array


def received(
    faults: Faults, sent: Array, t_sent_s: Array, t_cycles_s: Array, jitter_s: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Received reference (m, n) at each PLC cycle, and the number of the datagram it comes from (m,)."""
    late = (
        own.DELAY_S + faults.delay_s + np.abs(rng.normal(0.0, jitter_s, len(sent)))
        if jitter_s > 0.0
        else (np.full(len(sent), own.DELAY_S + faults.delay_s))
    )
    arrival = np.maximum.accumulate(t_sent_s + late)
    there = rng.uniform(size=len(sent)) >= faults.loss_frac
    there[0] = True
    kept = np.maximum.accumulate(np.where(there, np.arange(len(sent)), 0))
    number = kept[np.maximum(np.searchsorted(arrival, t_cycles_s, side="right") - 1, 0)]
    out = sent[number].copy()
    for j in range(out.shape[1]):
        step, rate = faults.joint[j, f.STEP], faults.joint[j, f.RATE]
        if step > 0.0:
            out[:, j] = np.round(out[:, j] / step) * step
        if np.isfinite(rate):
            out[:, j] = _limited(out[:, j], rate * own.CYCLE_S)
    return out, number


def _limited(x: Array, most: float) -> Array:
    y = x.copy()
    for k in range(1, len(y)):
        y[k] = y[k - 1] + min(max(x[k] - y[k - 1], -most), most)
    return y
