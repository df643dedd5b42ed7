"""A measured point that moves by itself: it does not repeat at a posture, and points as far out along the arm do.

Why: what does not repeat is taken for noise, and a prism that slipped once hides everything else behind its slip. Play
and swings move all that lies beyond their joint alike or more; a point that moves beside those is loose.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machine.rotations import Array

TIMES = 5.0  # what the other points show
LEAST_M = 2e-4
AGAIN_MIN = 3  # times that a point was measured again


def loose_point(squares: Array, again: NDArray[np.int64], joints: Sequence[int], names: Sequence[str]) -> str:
    """What a reader is told; empty where no point is loose.

    Args: of each point: `squares` (k,) [m^2] its deviations where it was measured again in one pose, summed over three
          axes; `again` (k,) how often that was; the joint whose link carries it, and its name.
    """
    rms = np.sqrt(squares / np.maximum(3 * again, 1))
    known = again >= AGAIN_MIN
    at = np.asarray(joints)
    for k in np.argsort(-rms):
        beyond = known & (at >= at[k])
        beyond[k] = False
        if known[k] and beyond.any() and rms[k] > max(TIMES * float(rms[beyond].max()), LEAST_M):
            sizes = f"{1e3 * rms[k]:.2g} mm, the others {1e3 * float(rms[beyond].max()):.2g} mm"
            return f"goes with point {names[k]!r}, which moves beside the others ({sizes}): fasten it"
    return ""
