"""What is known of one object in one pair: its sightings, undistorted once and laid out flat for the fits."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.camera import distortion_jacobian, undistort_to_rays
from machine.description import Marker, StereoCamera
from machine.markers import marker_corners
from machine.poses import inverse_pose, transform_points
from server.vision.contracts import Array
from server.vision.planar_pose import planar_poses, point_poses
from server.vision.pose_refinement import PointObservations


@dataclass(frozen=True, slots=True)
class Sighting:
    """One marker of an object in one pair; corners (4, 2) [raw px] or None where an eye does not see it."""

    marker: Marker
    left_px: Array | None
    right_px: Array | None

    @property
    def target_id(self) -> int:
        """The marker's id."""
        return self.marker.marker_id


@dataclass(frozen=True, slots=True)
class PointSighting:
    """Known points of an object in one pair, such as a board's inner corners.

    points_object (n, 3) [m]; left_px, right_px (n, 2) [raw px], a row of NaN for a point that this eye does not see,
    None where the eye sees none of them. `target_id` stands in `MarkerView.marker_id`, `label` in reasons.
    """

    label: str
    target_id: int
    points_object: Array
    left_px: Array | None
    right_px: Array | None


@dataclass(frozen=True, slots=True)
class SeenGroup:
    """Points of one sighting in one eye: rows `first_row` to `end_row` of the problem's arrays, which of them (n,) it
    sees."""

    sighting_index: int
    eye_index: int
    first_row: int
    end_row: int
    seen_mask: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PoseProblem:
    """All sightings of one object, undistorted once; rows grouped by sighting, then by eye."""

    sightings: tuple[Sighting | PointSighting, ...]
    camera: StereoCamera
    groups: tuple[SeenGroup, ...]
    observations: PointObservations

    def rows_of(self, indices: Sequence[int]) -> NDArray[np.bool_]:
        """Whether each row belongs to one of these sightings (n,)."""
        rows = np.zeros(len(self.observations.points_object), dtype=bool)
        for group in self.groups:
            rows[group.first_row : group.end_row] |= group.sighting_index in indices
        return rows

    def observations_of(self, indices: Sequence[int]) -> PointObservations:
        """The rows of these sightings only."""
        if len(indices) == len(self.sightings):
            return self.observations
        return self.observations.subset(self.rows_of(indices))

    def common_pixels(self) -> tuple[Array, Array]:
        """Points that both eyes see, undistorted (m, 2) [px], left and right."""
        pairs: dict[int, list[Array]] = {}
        for group in self.groups:
            pixels = np.full((len(object_points(self.sightings[group.sighting_index])), 2), np.nan)
            pixels[group.seen_mask] = self.observations.seen_px[group.first_row : group.end_row]
            pairs.setdefault(group.sighting_index, []).append(pixels)
        both = [pair for pair in pairs.values() if len(pair) == 2]
        if not both:
            return np.empty((0, 2)), np.empty((0, 2))
        left, right = (np.concatenate([pair[eye] for pair in both]) for eye in (0, 1))
        seen = np.isfinite(left).all(axis=1) & np.isfinite(right).all(axis=1)
        return left[seen], right[seen]

    def starting_poses(self, indices: Sequence[int]) -> Array:
        """T_cam_object (k, 4, 4) by both planar solutions of every sighting in every eye."""
        found = [start for group in self.groups if group.sighting_index in indices for start in self._starts_of(group)]
        return np.array(found) if found else np.empty((0, 4, 4))

    def _starts_of(self, group: SeenGroup) -> Iterator[Array]:
        sighting, seen = self.sightings[group.sighting_index], self.observations
        rays = seen.seen_px[group.first_row : group.end_row] / seen.focal_px
        if isinstance(sighting, Sighting):
            T_marker_object = inverse_pose(sighting.marker.T_on_marker)
            found = [T @ T_marker_object for T in planar_poses(rays, sighting.marker.side_m)]
        else:
            found = list(point_poses(rays, seen.points_object[group.first_row : group.end_row]))
        for start in found:
            start[0, 3] += seen.eye_x_m[group.first_row]
            yield start


def object_points(sighting: Sighting | PointSighting) -> Array:
    """The sighting's points (n, 3) [m] in object axes."""
    if isinstance(sighting, PointSighting):
        return np.asarray(sighting.points_object, dtype=float)
    return transform_points(sighting.marker.T_on_marker, marker_corners(sighting.marker.side_m))


def pose_problem(sightings: Sequence[Sighting | PointSighting], camera: StereoCamera) -> PoseProblem:
    """Undistort every seen point once."""
    points, pixels, eye_x, groups = [], [], [], []
    count = 0
    for index, sighting in enumerate(sightings):
        on_object = object_points(sighting)
        for eye, (px, x_m) in enumerate(((sighting.left_px, 0.0), (sighting.right_px, camera.baseline_m))):
            if px is None:
                continue
            seen: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(px), axis=1)
            n = int(seen.sum())
            if n == 0:
                continue
            points.append(on_object[seen])
            pixels.append(np.asarray(px, dtype=float)[seen])
            eye_x.append(np.full(n, x_m))
            groups.append(SeenGroup(index, eye, count, count + n, seen))
            count += n
    focal = np.array([camera.fx_px, camera.fy_px])
    if not groups:
        nothing = PointObservations(np.empty((0, 3)), np.empty((0, 2)), np.empty(0), focal)
        return PoseProblem(tuple(sightings), camera, (), nothing)
    rays = undistort_to_rays(camera, np.concatenate(pixels))
    weights = distortion_jacobian(camera, rays) * (focal[:, None] / focal)  # noise is even in raw pixels
    observations = PointObservations(np.concatenate(points), rays * focal, np.concatenate(eye_x), focal, weights)
    return PoseProblem(tuple(sightings), camera, tuple(groups), observations)
