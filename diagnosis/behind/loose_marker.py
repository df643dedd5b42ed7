"""A marker that moves by itself: between two looks at one posture it went elsewhere, and the other markers did not.

Why: what does not repeat is taken for noise, and a marker that hangs by one screw then hides everything else. Noise of
pixels is each corner's own; the four corners of a marker have no noise in common.
"""

from dataclasses import dataclass

import numpy as np

from machine.rotations import Array

CORNER_NOISE_RATIO_MIN = 5.0  # what each corner shows by itself
SHARED_MOTION_FRAC_MIN = 0.3  # of what all markers do together: seen in perspective, that is not the same for all
MARKER_MOTION_MIN_PX = 0.5
MARKER_VIEWS_MIN = 4
MARKERS_MIN = 3  # two alone turn and grow as a camera that moves shows them


@dataclass(frozen=True, slots=True)
class LooseMarker:
    """Which marker, how far it goes by itself, and the noise of each corner, standard deviations [px]."""

    marker_index: int
    moved_px: float
    own_px: float

    def message(self, marker_id: int) -> str:
        """The text for the report."""
        sizes = f"{self.moved_px:.2g} px, noise {self.own_px:.2g} px"
        return f"goes with marker {marker_id}, which moves against the others ({sizes}): fasten it"


def loose_marker(visits: list[Array], markers: int) -> LooseMarker | None:
    """Of residuals (k, 2 eyes x markers x 4, 2) [px] where one posture was seen k times, NaN unseen."""
    own, common, by_marker = np.zeros(2), np.zeros(2), np.zeros((markers, 2))
    for view in visits:
        looks = view.reshape(len(view), 2, markers, 4, 2)
        times = np.isfinite(looks).sum(axis=0)
        away = (looks - np.nansum(looks, axis=0) / np.maximum(times, 1)) * np.sqrt(times / np.maximum(times - 1, 1))
        for look in np.where(times > 1, away, np.nan):
            seen = np.isfinite(look).all(axis=(0, 2, 3))
            if int(seen.sum()) < MARKERS_MIN:
                continue
            means = look.mean(axis=(0, 2))
            own += [((look[:, seen] - means[seen][None, :, None]) ** 2).sum(), 14.0 * seen.sum()]
            centre = np.median(means[seen], axis=0)
            common += [float((centre**2).sum()), 2.0]
            by_marker[seen] += np.stack(
                [((means[seen] - centre) ** 2).sum(axis=1), np.full(int(seen.sum()), 2.0)], axis=1
            )
    enough = by_marker[:, 1] >= 2.0 * MARKER_VIEWS_MIN
    if int(enough.sum()) < MARKERS_MIN:
        return None
    own_px, common_px = float(np.sqrt(own[0] / own[1])), float(np.sqrt(common[0] / common[1]))
    moved = np.sqrt(by_marker[:, 0] / np.maximum(by_marker[:, 1], 1.0)) * enough
    worst = int(np.argmax(moved))
    least = max(CORNER_NOISE_RATIO_MIN * own_px, SHARED_MOTION_FRAC_MIN * common_px, MARKER_MOTION_MIN_PX)
    return LooseMarker(worst, float(moved[worst]), own_px) if moved[worst] > least else None
