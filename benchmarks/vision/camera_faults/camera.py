"""The faulty camera and its line: a pair in, JPEG on the wire, and the frame that the server would read of it."""

from dataclasses import dataclass

import numpy as np

from benchmarks.vision.camera_faults.pictures import RATE_HZ, PairOfEyes
from server.camera.contracts import StereoFrame
from server.camera.errors import StreamError
from server.camera.sources.side_by_side import decode_side_by_side
from sim_plc.camera.faults import FaultSwitch

JPEG_QUALITY = 95
LATENCY_S, JITTER_S = 0.050, 0.003
CAMERA_EPOCH_NS = -3_000_000_000_000
PC_EPOCH_NS = 1_000_000_000_000


@dataclass(frozen=True, slots=True)
class Arrival:
    """What came of one exposure: a frame, or none with its reason. `t_true_ns`: mid-exposure on the PC's clock."""

    frame: StereoFrame | None
    reason: str
    t_true_ns: int
    t_receive_ns: int


class Line:
    """Sends exposure after exposure through the fault switch."""

    def __init__(self, seed: int) -> None:
        self.switch = FaultSwitch()
        self._rng = np.random.default_rng([seed, 1])
        self._number = 0

    def send(self, pair: PairOfEyes) -> Arrival:
        """The next exposure."""
        self._number += 1
        t_ns = round(self._number * 1e9 / RATE_HZ)
        latency_s = LATENCY_S + JITTER_S * abs(float(self._rng.standard_normal()))
        t_true_ns = PC_EPOCH_NS + t_ns
        t_receive_ns = t_true_ns + round(1e9 * latency_s)
        stamp_ns = self.switch.stamp(CAMERA_EPOCH_NS + t_ns)
        jpeg = self.switch.sent(*pair, JPEG_QUALITY)
        if jpeg is None:
            return Arrival(None, "no picture", t_true_ns, t_receive_ns)
        try:
            left, right = decode_side_by_side(jpeg)
        except StreamError as error:
            return Arrival(None, str(error), t_true_ns, t_receive_ns)
        return Arrival(StereoFrame(left, right, stamp_ns, t_receive_ns, self._number), "", t_true_ns, t_receive_ns)
