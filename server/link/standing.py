"""Whether the machine stood still over the last samples of the PLC."""

from collections.abc import Sequence

import numpy as np

from server.link.contracts import PlcSample


def stood_still(
    samples: Sequence[PlcSample], window_s: float, moved_max_rad_s: float, referenced_max_rad_s: float
) -> bool:
    """Whether encoders moved less than the first limit over at least 80 % of the window, and the reference rests.

    Args: moved_max_rad_s: way of the joint that moved most, over the time; referenced_max_rad_s: of the newest
        sample's reference speeds.
    """
    if len(samples) < 2:
        return False
    span_s = (samples[-1].t_plc_ns - samples[0].t_plc_ns) * 1e-9
    if span_s < 0.8 * window_s:
        return False
    qs = np.array([sample.q_rad for sample in samples])
    moved = float(np.max(qs.max(axis=0) - qs.min(axis=0)))
    referenced = max(abs(value) for value in samples[-1].qd_ref_rad_s)
    return moved / span_s < moved_max_rad_s and referenced < referenced_max_rad_s
