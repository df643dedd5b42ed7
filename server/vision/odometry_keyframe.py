"""Keyframes: a stereo pair that is kept, and the points it put into the map."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machine.camera import distortion_jacobian, project_stereo, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, transform_points
from server.vision.contracts import Array
from server.vision.odometry_features import covered_cell_count
from server.vision.odometry_motion import moved_by_twist, row_fractions
from server.vision.odometry_sight import SearchPoints, Sight, StereoMatches


def wants_keyframe(inliers_px: Array, shape: tuple[int, int], points_min: float, cells_min: float) -> bool:
    """Whether a pair should become a keyframe: fewer points of the map are found in it, or in fewer of its cells.

    Args: inliers_px: (n, 2); shape: of the picture (rows, columns).
    """
    return len(inliers_px) < points_min or covered_cell_count(inliers_px, shape) < cells_min


def ray_noise(camera: StereoCamera, rays: Array) -> Array:
    """Covariances (n, 2, 2) of undistorted rays, in px of the focal length, for raw noise of 1 px; NaN rays give the
    identity.

    Model:   D^-1 D^-T, D = d(distorted ray) / d(ray).
    """
    known = np.isfinite(rays).all(axis=1)
    noise = np.tile(np.eye(2), (len(rays), 1, 1))
    inverse = np.linalg.inv(distortion_jacobian(camera, rays[known]))
    noise[known] = inverse @ inverse.transpose(0, 2, 1)
    return noise


def ray_sigma(camera: StereoCamera, rays: Array) -> Array:
    """The same as one number per ray (n,): the root of the mean variance of both coordinates."""
    noise = ray_noise(camera, rays)
    return np.sqrt(0.5 * (noise[:, 0, 0] + noise[:, 1, 1]))


SEARCH_FAILURES_MAX = 8  # more failed than found, and this often: the point is asked in turn only
RETRY_INTERVAL_PAIRS = 32  # pairs in which each of those is asked once more: what covered it may have gone
DEPTH_MIN_M = 0.05
MOTION_VOTES_MAX = 8  # pairs in a row that turn a point's verdict round
CAMERA_FIXED_VOTES_MAX = -2  # of two pairs: one may be chance, as where a texture repeats
Hides = Callable[[Array], NDArray[np.bool_]]


@dataclass(frozen=True, slots=True)
class SeenHere:
    """Points of older keyframes that a keyframe shows: serials and numbers in them (n,), raw pixels (n, 2) (right NaN
    where not shown)."""

    keyframe_serials: NDArray[np.int64]
    indices: NDArray[np.int64]
    left_px: Array
    right_px: Array


@dataclass(slots=True)
class Keyframe:
    """A kept pair and its n map points; its pose moves them when pose or velocity become better known.

    places_left_px, places_right_px (n, 2): raw pixels. points_row (n, 3) [m]: in the camera's axes at the moment its
    row was exposed. support_row (n, 2, 3): the points one raw pixel to the right and below, at the same depth.
    covariances_row (n, 3, 3) [m^2]. The same in vo, at mid-exposure of the middle row: points_vo, support_vo,
    covariances_vo. keyframe_influence: by a keyframe's serial (n, 3, 3): how far each point goes where that keyframe
    goes; they sum to the identity. motion_votes (n,): above 0 for a point that went with the world, below for one that
    went with the camera. seen_here: older points found again in this pair. twist_gain (6, 6): what the velocity's error
    did to this pose.
    """

    image_pair: Sight
    T_vo_cam: Array
    places_left_px: Array
    places_right_px: Array
    points_row: Array
    support_row: Array
    covariances_row: Array
    row_fractions: Array
    twist: Array
    points_vo: Array
    support_vo: Array
    covariances_vo: Array
    search_failures: NDArray[np.int64]
    motion_votes: NDArray[np.int8]
    serial: int = 0
    n_searches: int = 0
    keyframe_influence: dict[int, Array] = field(default_factory=dict)
    seen_here: "SeenHere | None" = None
    twist_gain: Array = field(default_factory=lambda: np.zeros((6, 6)))

    @property
    def n_points(self) -> int:
        """Points this keyframe put into the map."""
        return len(self.points_row)

    def count_misses(self, indices: NDArray[np.int64], found: NDArray[np.bool_]) -> None:
        """Hold the misses of a pair against the points that were looked for; those given up get their turn."""
        self.search_failures[indices] = np.clip(
            self.search_failures[indices] + np.where(found, -1, 1), 0, SEARCH_FAILURES_MAX
        )
        self.n_searches += 1
        turn = np.arange(self.n_searches % RETRY_INTERVAL_PAIRS, self.n_points, RETRY_INTERVAL_PAIRS)
        self.search_failures[turn] = np.minimum(self.search_failures[turn], SEARCH_FAILURES_MAX - 1)

    def vote_on_motion(self, indices: NDArray[np.int64], signs: NDArray[np.int8]) -> None:
        """One more pair says that points (m,) went with the world (1), with the camera (-1), or neither (0)."""
        self.motion_votes[indices] = np.clip(self.motion_votes[indices] + signs, -MOTION_VOTES_MAX, MOTION_VOTES_MAX)

    def place_points(self, T_vo_cam: Array, twist: Array, readout_s: float) -> None:
        """Put the map points where this pose, velocity (6,) and readout of the shutter say they are."""
        times = -self.row_fractions * readout_s
        self.twist = twist
        rotation = T_vo_cam[:3, :3]
        self.T_vo_cam = T_vo_cam
        self.points_vo = transform_points(T_vo_cam, moved_by_twist(self.points_row, twist, times))
        sides = [moved_by_twist(self.support_row[:, k], twist, times) for k in range(2)]
        self.support_vo = np.stack([transform_points(T_vo_cam, side) for side in sides], axis=1)
        self.covariances_vo = rotation @ self.covariances_row @ rotation.T

    def move_points(self, at: NDArray[np.int64], points_vo: Array, covariances_vo: Array, readout_s: float) -> None:
        """Give some points (m,) other places (m, 3) and covariances (m, 3, 3), in this keyframe's own axes too."""
        T_cam_vo = inverse_pose(self.T_vo_cam)
        middle = transform_points(T_cam_vo, points_vo)
        rows = moved_by_twist(middle, self.twist, self.row_fractions[at] * readout_s)
        self.support_row[at] += (rows - self.points_row[at])[:, None]
        self.points_row[at] = rows
        self.covariances_row[at] = T_cam_vo[:3, :3] @ covariances_vo @ T_cam_vo[:3, :3].T
        self.place_points(self.T_vo_cam, self.twist, readout_s)


def triangulated(camera: StereoCamera, found: StereoMatches, sigma_px: float) -> tuple[Array, Array]:
    """Points (n, 3) [m] in the left eye's axes and their covariances (n, 3, 3).

    Model:   z = f b / (x_left - x_right) on undistorted rays; the row is the mean of both eyes' rows. Each raw
             coordinate carries an independent error of sigma_px.
    """
    left, right = undistort_to_rays(camera, found.left_px), undistort_to_rays(camera, found.right_px)
    depth = camera.baseline_m / (left[:, 0] - right[:, 0])
    rays = np.column_stack([left[:, 0], 0.5 * (left[:, 1] + right[:, 1]), np.ones(len(left))])
    J = np.zeros((len(left), 3, 4))  # d(point) / d(x left, y left, x right, y right) in px
    slope = depth**2 / (camera.fx_px * camera.baseline_m)
    J[:, :, 0] = -rays * slope[:, None]
    J[:, :, 2] = rays * slope[:, None]
    J[:, 0, 0] += depth / camera.fx_px
    J[:, 1, 1] = J[:, 1, 3] = 0.5 * depth / camera.fy_px
    noise = np.zeros((len(left), 4, 4))
    noise[:, :2, :2], noise[:, 2:, 2:] = ray_noise(camera, left), ray_noise(camera, right)
    return rays * depth[:, None], sigma_px**2 * (J @ noise @ J.transpose(0, 2, 1))


def make_keyframe(
    camera: StereoCamera,
    sight: Sight,
    T_vo_cam: Array,
    twist: Array,
    found: StereoMatches,
    sigma_px: float,
    readout_s: float,
    serial: int = 0,
) -> Keyframe:
    """A keyframe at a known pose and velocity (6,) with its triangulated points; `sight` is kept as it is."""
    points, covariances = triangulated(camera, found, sigma_px)
    here = undistort_to_rays(camera, found.left_px)
    support = []
    for offset in (np.array([1.0, 0.0]), np.array([0.0, 1.0])):
        change = (undistort_to_rays(camera, found.left_px + offset) - here) * points[:, 2:]
        support.append(points + np.column_stack([change, np.zeros(len(points))]))
    empty = np.zeros((0, 3))
    keyframe = Keyframe(
        image_pair=sight,
        T_vo_cam=T_vo_cam,
        places_left_px=found.left_px,
        places_right_px=found.right_px,
        points_row=points,
        support_row=np.stack(support, axis=1),
        covariances_row=covariances,
        row_fractions=row_fractions(found.left_px[:, 1], camera.height_px),
        twist=twist,
        points_vo=empty,
        support_vo=empty,
        covariances_vo=empty,
        search_failures=np.zeros(len(points), dtype=np.int64),
        motion_votes=np.zeros(len(points), dtype=np.int8),
    )
    keyframe.serial = serial
    keyframe.keyframe_influence = {serial: np.tile(np.eye(3), (len(points), 1, 1))}
    keyframe.place_points(T_vo_cam, twist, readout_s)
    return keyframe


def expect_points(
    camera: StereoCamera, keyframe: Keyframe, T_vo_cam: Array, sight: Sight, hides: Hides
) -> SearchPoints:
    """Which of a keyframe's points a pair taken at `T_vo_cam` shows, and where.

    A point is left out where it lies under the mask or own structure hides it, where it is own structure itself, where
    the patch would be seen at less than 0.4 or more than 2.5 times its area, or where it has failed too often and it is
    not its turn.
    """
    T_cam_vo = inverse_pose(T_vo_cam)
    points_cam = transform_points(T_cam_vo, keyframe.points_vo)
    indices = np.flatnonzero(
        (points_cam[:, 2] > DEPTH_MIN_M)
        & (keyframe.search_failures < SEARCH_FAILURES_MAX)
        & (keyframe.motion_votes > CAMERA_FIXED_VOTES_MAX)
    )
    left_px, right_px = project_stereo(camera, points_cam[indices])
    near = sight.may_show(left_px) & ~hides(left_px)
    indices, left_px, right_px = indices[near], left_px[near], right_px[near]
    columns = [
        project_stereo(camera, transform_points(T_cam_vo, keyframe.support_vo[indices, k]))[0] - left_px
        for k in range(2)
    ]
    growth = np.stack(columns, axis=2)  # d(new px)/d(keyframe px)
    area = growth[:, 0, 0] * growth[:, 1, 1] - growth[:, 0, 1] * growth[:, 1, 0]
    usable = (area > 0.4) & (area < 2.5)
    indices, growth = indices[usable], growth[usable]
    return SearchPoints(
        indices=indices,
        places_left_px=keyframe.places_left_px[indices],
        places_right_px=keyframe.places_right_px[indices],
        warps=np.asarray(np.linalg.inv(growth), float),
        guesses_left_px=left_px[usable],
        guesses_right_px=right_px[usable],
    )
