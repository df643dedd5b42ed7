"""Looks on the way: what a plan asks for while the machine moves, and what it gets: pairs that showed both objects."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from server.calibration.contracts import Array
from server.vision.contracts import PairObservation, PoseStatus

USABLE = (PoseStatus.OK, PoseStatus.ORIENTATION_AMBIGUOUS)


@dataclass(frozen=True, slots=True)
class StartWatching:
    """Keep every pair's poses from now on. Reply: None."""

    source: Literal["stereo", "mono"]


@dataclass(frozen=True, slots=True)
class StopWatching:
    """Reply: (Sighted, EncoderTrack) since StartWatching."""


@dataclass(frozen=True, slots=True)
class Sighted:
    """Pairs that showed both: times (n,) [s, camera clock mapped], OOI minus tool (n, 3) [m], Rs_cam_ooi (n, 3, 3)."""

    t_s: Array
    vectors_cam: Array
    Rs_cam_ooi: Array


def sighted_of(pairs: Iterable[tuple[float, PairObservation]]) -> Sighted:
    """From (time [s], pair); pairs without both objects are left out."""
    t, vectors, turns = [], [], []
    for t_s, pair in pairs:
        tool, ooi = pair.tool.T_cam_object, pair.ooi.T_cam_object
        if pair.tool.status in USABLE and pair.ooi.status in USABLE and tool is not None and ooi is not None:
            t.append(t_s)
            vectors.append(ooi[:3, 3] - tool[:3, 3])
            turns.append(ooi[:3, :3])
    return Sighted(np.array(t), np.array(vectors).reshape(-1, 3), np.array(turns).reshape(-1, 3, 3))
