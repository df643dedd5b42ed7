"""Where the joint fit of a layout starts: each marker alone in each view, then pairs that were seen together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine.camera import undistort_to_rays
from machine.description import Marker, StereoCamera
from machine.markers import CORNER_SIGNS
from machine.poses import inverse_pose
from machine.rotations import geodesic_angle
from server.vision.contracts import Array
from server.vision.pose_problem import Sighting, pose_problem
from server.vision.pose_refinement import distinct_minima
from server.vision.teach_contracts import TeachView
from server.vision.teach_fit import Corners, LayoutState

UNIT_CORNERS = 0.5 * CORNER_SIGNS
SAME_POSE_ANGLE_MAX_RAD = np.deg2rad(1.0)
POSE_DISTANCE_MAX = 1.0  # distance at which two candidates have nothing in common
ANGLE_UNIT_RAD, LENGTH_UNIT_FRAC = np.deg2rad(10.0), 0.1  # of the marker's side: what counts as one unit apart
CANDIDATES_MAX = 3
START_VIEWS_MAX = 12


@dataclass(frozen=True, slots=True)
class SeenViews:
    """Views with the wanted markers only: ids in order, per view the places of the markers that it shows."""

    marker_ids: tuple[int, ...]
    views: tuple[TeachView, ...]

    def markers_in_view(self, view: int) -> list[int]:
        """Places (in `marker_ids`) of the markers in one view, by either eye."""
        one = self.views[view]
        return [
            k
            for k, marker_id in enumerate(self.marker_ids)
            if marker_id in one.left_corners_px or marker_id in one.right_corners_px
        ]


def corners_of(seen: SeenViews, camera: StereoCamera) -> Corners:
    """All corners as rows, undistorted once."""
    view, marker, right, pixels = [], [], [], []
    for v, shot in enumerate(seen.views):
        for k, marker_id in enumerate(seen.marker_ids):
            for eye, found in enumerate((shot.left_corners_px, shot.right_corners_px)):
                if marker_id in found:
                    view.append(v)
                    marker.append(k)
                    right.append(eye)
                    pixels.append(np.asarray(found[marker_id], dtype=float).reshape(4, 2))
    focal = np.array([camera.fx_px, camera.fy_px])
    rays = undistort_to_rays(camera, np.concatenate(pixels))
    views, markers = np.repeat(view, 4), np.repeat(marker, 4)
    return Corners(
        view_indices=views,
        marker_indices=markers,
        sighting_indices=views * len(seen.marker_ids) + markers,
        unit_corners=np.tile(UNIT_CORNERS, (len(view), 1)),
        is_right_eye=np.repeat(np.array(right, dtype=float), 4),
        seen_px=rays * focal,
        focal_px=focal,
        baseline_m=camera.baseline_m,
    )


def side_by_stereo(left_px: Array, right_px: Array, camera: StereoCamera) -> float:
    """Mean side [m] of a square by triangulation; NaN where the disparity is not positive."""
    left, right = (undistort_to_rays(camera, px) for px in (left_px, right_px))
    disparity = left[:, 0] - right[:, 0]
    if np.any(disparity <= 0.0):
        return float("nan")
    points = np.column_stack([left, np.ones(4)]) * (camera.baseline_m / disparity)[:, None]
    return float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).mean())


def first_sides(seen: SeenViews, printed_m: Mapping[int, float], camera: StereoCamera) -> Array:
    """Side (m,) [m] of each marker: as printed, else the median by stereo; NaN where no view shows it to both eyes."""
    sides = []
    for marker_id in seen.marker_ids:
        by_stereo = [
            side_by_stereo(
                np.asarray(shot.left_corners_px[marker_id]), np.asarray(shot.right_corners_px[marker_id]), camera
            )
            for shot in seen.views
            if marker_id in shot.left_corners_px and marker_id in shot.right_corners_px
        ]
        finite = [side for side in by_stereo if np.isfinite(side)]
        sides.append(printed_m.get(marker_id, float(np.median(finite)) if finite else float("nan")))
    return np.array(sides)


def groups_seen_together(seen: SeenViews) -> list[list[int]]:
    """Markers (places in `marker_ids`) that hang together through views that show two of them, largest group first."""
    group = list(range(len(seen.marker_ids)))
    for view in range(len(seen.views)):
        shown = seen.markers_in_view(view)
        joined = {group[k] for k in shown}
        group = [min(joined) if root in joined else root for root in group]
    found = [[k for k, root in enumerate(group) if root == name] for name in sorted(set(group))]
    return sorted(found, key=len, reverse=True)


def start_of(seen: SeenViews, sides_m: Array, camera: StereoCamera) -> LayoutState | None:
    """First values of all unknowns; None where some marker or view has no pose in front of the camera.

    Model:   T_a_b of every pair seen together = the candidate that most views agree on; chained from the reference
             along the pairs seen together most often; each view by its best start over all its markers.
    """
    alone = [
        {k: _pose_candidates(shot, seen.marker_ids[k], sides_m[k], camera) for k in seen.markers_in_view(v)}
        for v, shot in enumerate(seen.views)
    ]
    Ts = _chain_marker_poses(alone, sides_m)
    if Ts is None:
        return None
    views = [_view_pose(seen, v, alone[v], Ts, sides_m, camera) for v in range(len(seen.views))]
    found = [T for T in views if T is not None]
    if len(found) < len(views):
        return None
    return LayoutState(np.array(Ts), np.array(found), sides_m.copy(), 0.0)


def _pose_candidates(view: TeachView, marker_id: int, side_m: float, camera: StereoCamera) -> list[Array]:
    """T_cam_marker by this marker alone: its distinct minima, the best first."""
    marker = Marker(marker_id, float(side_m), "ooi", np.eye(4))
    problem = pose_problem(
        [Sighting(marker, view.left_corners_px.get(marker_id), view.right_corners_px.get(marker_id))], camera
    )
    minima = distinct_minima(problem.starting_poses([0]), problem.observations, SAME_POSE_ANGLE_MAX_RAD)
    return [minimum.T_cam_object for minimum in minima[:CANDIDATES_MAX]]


def _pose_distance(one: Array, other: Array, length_m: float) -> float:
    angle = geodesic_angle(one[:3, :3], other[:3, :3]) / ANGLE_UNIT_RAD
    return min(angle + float(np.linalg.norm(one[:3, 3] - other[:3, 3])) / length_m, POSE_DISTANCE_MAX)


def _consensus_pose(by_view: Sequence[Sequence[Array]], length_m: float) -> Array:
    """The candidate with the least sum of distances to the nearest candidate of every view."""
    everything = [T for candidates in by_view for T in candidates]
    costs = [
        sum(min(_pose_distance(T, other, length_m) for other in candidates) for candidates in by_view)
        for T in everything
    ]
    return everything[int(np.argmin(costs))]


def _chain_marker_poses(alone: Sequence[Mapping[int, list[Array]]], sides_m: Array) -> list[Array] | None:
    n = len(sides_m)
    known: dict[int, Array] = {0: np.eye(4)}
    while len(known) < n:
        pairs = [(a, b, _relative_pose_candidates(alone, a, b)) for a in known for b in range(n) if b not in known]
        a, b, by_view = max(pairs, key=lambda pair: len(pair[2]))
        if not by_view:
            return None
        known[b] = known[a] @ _consensus_pose(by_view, LENGTH_UNIT_FRAC * float(sides_m[b]))
    return [known[k] for k in range(n)]


def _relative_pose_candidates(alone: Sequence[Mapping[int, list[Array]]], a: int, b: int) -> list[list[Array]]:
    """Candidates of T_a_b by view."""
    both = [(candidates[a], candidates[b]) for candidates in alone if candidates.get(a) and candidates.get(b)]
    return [[inverse_pose(T_a) @ T_b for T_a in first for T_b in second] for first, second in both[:START_VIEWS_MAX]]


def _view_pose(
    seen: SeenViews, view: int, alone: Mapping[int, list[Array]], Ts: list[Array], sides_m: Array, camera: StereoCamera
) -> Array | None:
    one = seen.views[view]
    sightings = [
        Sighting(
            Marker(seen.marker_ids[k], float(sides_m[k]), "ooi", Ts[k]),
            one.left_corners_px.get(seen.marker_ids[k]),
            one.right_corners_px.get(seen.marker_ids[k]),
        )
        for k in alone
    ]
    starts = [T_cam_marker @ inverse_pose(Ts[k]) for k, found in alone.items() for T_cam_marker in found]
    if not starts:
        return None
    minima = distinct_minima(np.array(starts), pose_problem(sightings, camera).observations, SAME_POSE_ANGLE_MAX_RAD)
    return minima[0].T_cam_object if minima else None
