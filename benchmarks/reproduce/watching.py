"""Looks on the way in the fast world: single pairs along what the machine did."""

import numpy as np

from benchmarks.reproduce.fast_camera import FastCamera, Source
from benchmarks.reproduce.fast_machine import Trace
from server.jobs.requests import SeenPairs, sighted_of

RATE_HZ = 10.0


def watch(camera: FastCamera, trace: Trace, source: Source, late_s: float) -> SeenPairs:
    """Single pairs along a trace at `RATE_HZ`, their stamps late by `late_s`."""
    picks = np.searchsorted(trace.t_s, np.arange(trace.t_s[0], trace.t_s[-1], 1.0 / RATE_HZ))
    return sighted_of(
        (float(trace.t_s[k]) + late_s, camera.pair(trace.Ts_base_tcp[k], source, round(1e9 * float(trace.t_s[k]))))
        for k in picks
    )
