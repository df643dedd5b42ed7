"""A marker that jumps: from one pair to the next further than a machine can accelerate a camera.

A damaged picture may be shifted by whole blocks of its JPEG, in both eyes alike: every marker in it then fits a pose,
and only the pairs before it say that this is not where the marker was about to be.
"""

from dataclasses import dataclass

import numpy as np

from server.camera.health.findings import FaultCode, Finding
from server.camera.health.pair import Pair
from server.vision.contracts import Array

JUMP_MIN_PX = 4.0  # half of the smallest block of a JPEG
ALIKE_MAX_PX = 0.5  # between the eyes: blocks shift both by the same, a step in depth does not
INTERVAL_MAX_S = (
    0.12  # of a 10 Hz camera; 4 px in it, from rest, at 1 m and 700 px focal length: 0.8 m/s^2, cranes have 0.5
)


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Corners (n, 2) of a marker in one eye, and their common speed [px/ns]; None at the first sighting."""

    corners_px: Array
    speed: Array | None = None


class JumpMonitor:
    """Compares each marker with where the speed of its last step would have taken it."""

    def __init__(self) -> None:
        self._t_ns = 0
        self._seen: dict[tuple[int, str], _Seen] = {}

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """The marker that is furthest off, where any is too far; its first two sightings are not judged."""
        if pair.observation is None:
            return ()
        interval_ns = pair.frame.t_exposure_ns - self._t_ns
        comparable = not pair.first and 0 < interval_ns <= INTERVAL_MAX_S * 1e9
        before = self._seen if comparable else {}
        self._t_ns, self._seen = pair.frame.t_exposure_ns, {}
        worst_px, worst = 0.0, ""
        for view in pair.observation.views:
            offs_px: list[Array] = []
            for eye, corners in (("left", view.corners_left_px), ("right", view.corners_right_px)):
                if not view.used or corners is None:
                    continue
                key, found = (view.marker_id, eye), np.asarray(corners, dtype=float)
                if key not in before:
                    self._seen[key] = _Seen(found)
                    continue
                speed = before[key].speed
                off_px = _off(found, before[key].corners_px + (0.0 if speed is None else speed * interval_ns))
                self._seen[key] = _Seen(found, off_px / interval_ns + (0.0 if speed is None else speed))
                if speed is not None:
                    offs_px.append(off_px)
            alike = bool(offs_px) and float(np.linalg.norm(offs_px[0] - offs_px[-1])) < ALIKE_MAX_PX
            size_px = float(np.linalg.norm(offs_px[0])) if alike else 0.0  # of one eye the residual says more
            if size_px > worst_px:
                worst_px, worst = size_px, f"marker {view.marker_id} jumped by {size_px:.1f} px"
        if worst_px <= JUMP_MIN_PX:
            return ()
        text = (
            f"{worst} from one pair to the next (limit {JUMP_MIN_PX:g} px): the picture is damaged, or something was "
            "struck; check cable, network and the camera's encoder"
        )
        return (Finding(FaultCode.JUMPED, text, forbids_odometry=False),)


def _off(found: Array, predicted: Array) -> Array:
    """From the predicted corners to the nearest found ones (2,) [px], the median: a board's sets may differ."""
    between = found[:, None] - predicted[None]
    nearest = np.linalg.norm(between, axis=2).argmin(axis=1)
    return np.median(between[np.arange(len(found)), nearest], axis=0)
