"""A measured point that moves by itself: it does not repeat at a posture, and points as far out along the arm do.

Why: what does not repeat is taken for noise, and a prism that slipped once hides everything else behind its slip. Play
and oscillations move all that lies beyond their joint alike or more; a point that moves against those is loose.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machine.rotations import Array

SCATTER_RATIO_MIN = 5.0  # what the other points show
POINT_MOTION_MIN_M = 2e-4
LINK_POINTS_MIN, SEEN_MIN = 3, 8
REPEAT_MEASUREMENTS_MIN = 3  # times that a point was measured again


def loose_point(squares: Array, again: NDArray[np.int64], joints: Sequence[int], names: Sequence[str]) -> str:
    """The text for the report; empty where no point is loose.

    Args: of each point: `squares` (k,) [m^2] its deviations where it was measured again in one pose, summed over three
          axes; `again` (k,) how often that was; the joint whose link carries it, and its name.
    """
    rms = np.sqrt(squares / np.maximum(3 * again, 1))
    known = again >= REPEAT_MEASUREMENTS_MIN
    at = np.asarray(joints)
    for k in np.argsort(-rms):
        beyond = known & (at >= at[k])
        beyond[k] = False
        if known[k] and beyond.any() and rms[k] > max(SCATTER_RATIO_MIN * float(rms[beyond].max()), POINT_MOTION_MIN_M):
            sizes = f"{1e3 * rms[k]:.2g} mm, the others {1e3 * float(rms[beyond].max()):.2g} mm"
            return f"goes with point {names[k]!r}, which moves against the others ({sizes}): fasten it"
    return ""


def off_its_link(xyz: Array, which: NDArray[np.int64], when: Array, joints: Sequence[int], names: Sequence[str]) -> str:
    """Which point does not keep its distances to the others on its link, in words; empty where all do.

    Args: xyz: (m, 3) [m] of points `which` (m,), measured at `when` (m,); joints and names: of each point.
    Why:  what the arm, its frame and its encoders do leaves these distances alone, so that no repeat is needed.
    """
    number = np.unique(when, return_inverse=True)[1].reshape(-1)
    at = np.full((int(number.max(initial=-1)) + 1, len(names), 3), np.nan)
    at[number, which] = xyz
    for joint in sorted(set(joints)):
        of_link = [k for k, other in enumerate(joints) if other == joint]
        if len(of_link) < LINK_POINTS_MIN:
            continue
        scatter = np.array([[_distance_std(at[:, a] - at[:, b]) for b in of_link] for a in of_link])
        for k, point in enumerate(of_link):
            own = np.delete(scatter[k], k)
            rest = np.delete(np.delete(scatter, k, axis=0), k, axis=1)
            others = float(rest[np.triu_indices(len(rest), 1)].max())
            if np.isfinite(scatter).all() and own.min() > max(SCATTER_RATIO_MIN * others, POINT_MOTION_MIN_M):
                sizes = f"{1e3 * own.min():.2g} mm, theirs {1e3 * others:.2g} mm"
                text = f"goes with point {names[point]!r}, whose distances to the others on its link vary"
                return f"{text} ({sizes}): fasten it"
    return ""


def _distance_std(apart: Array) -> float:
    """Standard deviation of a distance, of vectors (m, 3) [m]; infinite where too few were seen, 0 to itself."""
    seen = apart[np.isfinite(apart).all(axis=1)]
    return float(np.std(np.linalg.norm(seen, axis=1))) if len(seen) >= SEEN_MIN else np.inf
