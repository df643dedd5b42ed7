"""On which side of its play a joint rests: it lags behind the way it last came, once it came far enough."""

import numpy as np

from server.calibration.contracts import Array


def play_sides(qs: Array, widths_rad: Array, start: Array) -> Array:
    """Side of every joint along a path.

    Model:   play operator: the side grows by 2 dq / width and stays within -1 to 1; +1 after a way up, when what the
             encoder turns is half a width behind. Joints without play stay at 0.
    Args:    qs: encoders (m, n) [rad] in order. widths_rad: about how wide each joint's play is (n,). start: sides
             before the first sample (n,), 0 where nothing is known.
    Returns: (m, n), -1 to 1.
    """
    sides = np.empty_like(qs)
    side = np.where(widths_rad > 0.0, start, 0.0)
    gain = np.divide(2.0, widths_rad, out=np.zeros_like(widths_rad), where=widths_rad > 0.0)
    before = qs[0] if len(qs) else start
    for i, q in enumerate(qs):
        side = np.clip(side + gain * (q - before), -1.0, 1.0)
        sides[i], before = side, q
    return sides
