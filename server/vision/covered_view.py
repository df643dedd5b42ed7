"""One eye's view of one target that lies: something bright covers an edge, and the corners follow its border.

A white board in front of a marker's lower edge looks like the marker's own quiet zone, so the detector cannot know. The
other eye looks past it, and the rigid layout outvotes the one view. A target that has really moved lies in both eyes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from server.vision.contracts import Array
from server.vision.pose_problem import PointSighting, PoseProblem, SeenGroup, Sighting
from server.vision.pose_refinement import PointObservations, RefinedPose, distinct_minima

TARGETS_MIN = 2  # with one target only nothing can outvote its other eye
LEFT_SHARE = 0.4  # of the residual at most, once the lying view is out
RUNNER_UP = 1.5  # leaving out any other view leaves at least so many times as much: it is that view and no other
EYES = ("left", "right")


@dataclass(frozen=True, slots=True)
class Cleared:
    """The sightings without the view that contradicts all others, and what to say of it."""

    sightings: tuple[Sighting | PointSighting, ...]
    reason: str


def without_covered_view(problem: PoseProblem, best: RefinedPose, apart_rad: float) -> Cleared | None:
    """The view whose absence, and no other's, makes the rest fit; None where there is no such view.

    Args: best: the pose by all views; apart_rad: minima nearer than this are one.
    """
    groups = _doubly_seen(problem)
    if len({group.sighting for group in problem.groups}) < TARGETS_MIN or len(problem.groups) < 4 or not groups:
        return None
    left = np.array([_rms_without(problem, group, best.T_cam_object, apart_rad) for group in groups])
    order = np.argsort(left)
    chosen, least = groups[int(order[0])], float(left[order[0]])
    before = float(np.sqrt(best.sum_squares_px2 / best.residuals_px.size))
    if least > LEFT_SHARE * before or (len(order) > 1 and left[order[1]] < RUNNER_UP * least):
        return None
    sightings = list(problem.sightings)
    one, eye = sightings[chosen.sighting], EYES[chosen.eye]
    sightings[chosen.sighting] = replace(one, left_px=None) if chosen.eye == 0 else replace(one, right_px=None)
    return Cleared(
        tuple(sightings), f"marker {one.target_id} is covered in the {eye} eye by something bright: not used there"
    )


def _doubly_seen(problem: PoseProblem) -> list[SeenGroup]:
    """Views of targets that the other eye sees, too."""
    seen = [group.sighting for group in problem.groups]
    return [group for group in problem.groups if seen.count(group.sighting) > 1]


def _rms_without(problem: PoseProblem, group: SeenGroup, T_cam_object: Array, apart_rad: float) -> float:
    rows = np.ones(len(problem.observations.points_object), dtype=bool)
    rows[group.first : group.end] = False
    found = distinct_minima(T_cam_object[None], _cut(problem.observations, rows), apart_rad)
    if not found:
        return float("inf")
    return float(np.sqrt(found[0].sum_squares_px2 / found[0].residuals_px.size))


def _cut(whole: PointObservations, rows: Sequence[bool] | np.ndarray) -> PointObservations:
    weights = None if whole.weights is None else whole.weights[rows]
    return PointObservations(
        whole.points_object[rows], whole.seen_px[rows], whole.eye_x_m[rows], whole.focal_px, weights
    )
