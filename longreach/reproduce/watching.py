"""Looks on the way: requests that a plan makes while the machine moves, and what the fast world answers."""

from dataclasses import dataclass

import numpy as np

from longreach.reproduce.fast_camera import FastCamera, Source
from longreach.reproduce.fast_machine import Trace
from machine.rotations import Array
from server.vision.contracts import PoseStatus

RATE_HZ = 10.0
USABLE = (PoseStatus.OK, PoseStatus.ORIENTATION_AMBIGUOUS)


@dataclass(frozen=True, slots=True)
class StartWatching:
    """Keep every pair's poses from now on. Reply: None."""

    source: Source


@dataclass(frozen=True, slots=True)
class StopWatching:
    """Reply: (Sighted, EncoderTrack) since StartWatching."""


@dataclass(frozen=True, slots=True)
class Sighted:
    """Pairs that showed both: times (n,) [s, camera clock mapped], OOI minus tool (n, 3) [m], Rs_cam_ooi (n, 3, 3)."""

    t_s: Array
    vectors_cam: Array
    Rs_cam_ooi: Array


def watch(camera: FastCamera, trace: Trace, source: Source, late_s: float) -> Sighted:
    """Single pairs along a trace at `RATE_HZ`, their stamps late by `late_s`."""
    picks = np.searchsorted(trace.t_s, np.arange(trace.t_s[0], trace.t_s[-1], 1.0 / RATE_HZ))
    t, vectors, turns = [], [], []
    for k in picks:
        pair = camera.pair(trace.Ts_base_tcp[k], source, round(1e9 * float(trace.t_s[k])))
        tool, ooi = pair.tool.T_cam_object, pair.ooi.T_cam_object
        if pair.tool.status in USABLE and pair.ooi.status in USABLE and tool is not None and ooi is not None:
            t.append(trace.t_s[k] + late_s)
            vectors.append(ooi[:3, 3] - tool[:3, 3])
            turns.append(ooi[:3, :3])
    return Sighted(np.array(t), np.array(vectors).reshape(-1, 3), np.array(turns).reshape(-1, 3, 3))
