"""Short runs of the odometry on simulated points: exact projections, Gaussian corner noise, no images."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from benchmarks.vision.odometry.film import nominal_machine
from benchmarks.vision.odometry.judged import judge
from benchmarks.vision.odometry.paths import SHAPES, SwayingPath, drawn_path
from machine.camera import project_stereo
from machine.description import StereoCamera
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import Array, rotation_from_rotvec
from server.vision.contracts import OdometryStatus
from server.vision.odometry import OdometrySettings, StereoOdometry
from server.vision.odometry_align import Alignment
from server.vision.odometry_features import BORDER_PX
from server.vision.odometry_motion import mean_twist, moved_by_twist, row_fractions
from server.vision.odometry_sight import Flow, SearchPoints, Sight, StereoMatches

WALL_POINTS = 6000
WALL_HALF_M = 3.5
RELIEF_M = 0.05
POSES_PER_RUN = 20
RATE_HZ = 6.0  # far enough between poses that a short run covers a way and needs new keyframes
READOUT_S = 0.011
DISTANCES_M = (0.7, 2.0)


@dataclass(frozen=True, slots=True)
class Wall:
    """Points (n, 3) [m] of a wall with relief, in the OOI's axes."""

    points: Array


@dataclass(frozen=True, slots=True)
class PointSight:
    """One simulated pair: true places of wall points in both eyes plus one draw of corner noise for this pair."""

    t_exposure_ns: int
    camera: StereoCamera
    left_px: Array  # (n, 2) with noise; NaN where not in view
    right_px: Array
    rng: np.random.Generator = field(repr=False)
    numbers: dict[tuple[float, float], int] = field(default_factory=dict, repr=False)  # of the points that were chosen

    def match_eyes(self, camera: StereoCamera, count: int, occupied_px: Array) -> StereoMatches:
        """Random visible points, at most one per free cell."""
        cell = np.sqrt(camera.height_px * camera.width_px / count)
        columns = int(camera.width_px // cell) + 2
        known = np.flatnonzero(~np.isnan(self.left_px[:, 0]) & ~np.isnan(self.right_px[:, 0]))
        order = self.rng.permutation(known)
        cells = (self.left_px[order] // cell).astype(int) @ [1, columns]
        taken = np.unique((occupied_px // cell).astype(int) @ np.array([1, columns]))
        _, first = np.unique(cells, return_index=True)
        chosen = order[first[~np.isin(cells[first], taken)]]
        self.numbers.update(zip(map(tuple, self.left_px[chosen].tolist()), chosen.tolist(), strict=True))
        return StereoMatches(self.left_px[chosen], self.right_px[chosen])

    def numbers_of(self, places_px: Array) -> NDArray[np.int64]:
        """Which wall points have these places (k, 2) in the left eye."""
        return np.array([self.numbers[x, y] for x, y in places_px.tolist()], dtype=np.int64)

    def find_points(self, kept: Sight, wanted: SearchPoints) -> tuple[Alignment, Alignment]:
        """The same wall points in this pair."""
        on = _points_sight(kept).numbers_of(wanted.places_left_px)
        found = [self.left_px[on], self.right_px[on]]
        goods = [~np.isnan(places[:, 0]) for places in found]
        places, seen = map(tuple, self.left_px[on][goods[0]].tolist()), on[goods[0]].tolist()
        self.numbers.update(zip(places, seen, strict=True))  # a later pair may follow them from here
        left, right = (Alignment(p, np.ones(len(on)), g) for p, g in zip(found, goods, strict=True))
        return left, right

    def may_show(self, left_px: Array) -> NDArray[np.bool_]:
        """Inside the image, away from the border."""
        size = np.array([self.camera.width_px, self.camera.height_px])
        return np.asarray(((left_px > BORDER_PX) & (left_px < size - BORDER_PX)).all(axis=1))

    def flow_from(self, kept: Sight, places_left_px: Array) -> Flow:
        """The same wall points in this left eye."""
        on = _points_sight(kept).numbers_of(places_left_px)
        return Flow(self.left_px[on], ~np.isnan(self.left_px[on, 0]))

    def recognise(self, kept: Sight) -> tuple[Array, Array]:
        """The same wall points."""
        places = np.array(list(_points_sight(kept).numbers), dtype=float).reshape(-1, 2)
        found = self.flow_from(kept, places)
        return places[found.valid], found.points_px[found.valid]

    def repetition_ways(self) -> Array:
        """Points are known by their numbers."""
        return np.zeros((0, 2))

    def keep_copy(self) -> "PointSight":
        """It never changes."""
        return self


def _points_sight(kept: Sight) -> PointSight:
    if not isinstance(kept, PointSight):
        raise TypeError(f"simulated points are compared with simulated points, not with {type(kept).__name__}")
    return kept


def drawn_wall(rng: np.random.Generator) -> Wall:
    """Points all over a wall of 7 m with 50 mm of relief."""
    flat = rng.uniform(-WALL_HALF_M, WALL_HALF_M, (WALL_POINTS, 2))
    return Wall(np.column_stack([flat, rng.uniform(-0.5 * RELIEF_M, 0.5 * RELIEF_M, WALL_POINTS)]))


def look(
    wall: Wall,
    camera: StereoCamera,
    path: SwayingPath,
    t_ns: int,
    sigma_px: float,
    readout_s: float,
    rng: np.random.Generator,
) -> PointSight:
    """A pair of the wall: every point where its row's exposure shows it, with noise."""
    T_tcp_cam = nominal_machine().T_tcp_cam_left
    T_ooi_cam = path.pose_at(t_ns) @ T_tcp_cam
    half_ns = 1_000_000
    ends = [path.pose_at(t_ns + sign * half_ns) @ T_tcp_cam for sign in (-1, 1)]
    twist = mean_twist(inverse_pose(ends[0]) @ ends[1], 2 * half_ns)
    still = transform_points(inverse_pose(T_ooi_cam), wall.points)
    points = still
    for _ in range(3):  # the row decides when, and when decides the row
        rows_px = project_stereo(camera, points)[0][:, 1]
        times_s = np.clip(row_fractions(rows_px, camera.height_px), -0.6, 0.6) * readout_s
        points = moved_by_twist(still, twist, np.nan_to_num(times_s))
    eyes = []
    for places in project_stereo(camera, points):
        noisy = places + rng.normal(0.0, sigma_px, places.shape)
        outside = ((noisy < BORDER_PX) | (noisy > [camera.width_px - BORDER_PX, camera.height_px - BORDER_PX])).any(1)
        noisy[outside | np.isnan(noisy).any(axis=1)] = np.nan
        eyes.append(noisy)
    return PointSight(t_ns, camera, eyes[0], eyes[1], rng)


def run_points(seed: int, settings: OdometrySettings | None = None, readout_s: float = 0.0) -> dict[str, Any]:
    """One short run: chi2 of position and rotation at each pose after the first.

    The calibration's scale error is drawn from `sigma_scale_frac`: the true baseline is longer by it.
    """
    rng = np.random.default_rng([seed, 4])
    told = OdometrySettings() if settings is None else settings
    settings = replace(told, readout_s=readout_s)
    machine = nominal_machine()
    true = replace(
        machine.camera, baseline_m=machine.camera.baseline_m * (1.0 + rng.normal(0.0, told.sigma_scale_frac))
    )
    distance_m = float(rng.uniform(*DISTANCES_M))
    facing = pose(np.diag([1.0, -1.0, -1.0]), np.array([*rng.uniform(-0.5, 0.5, 2), distance_m]))
    tilt = pose(rotation_from_rotvec(np.deg2rad(rng.uniform(-6.0, 6.0, 3))), np.zeros(3))
    start = facing @ tilt @ inverse_pose(machine.T_tcp_cam_left)
    path = drawn_path(SHAPES[seed % len(SHAPES)], start, float(rng.uniform(0.10, 0.15)), rng)  # type: ignore[arg-type]
    wall, odometry = drawn_wall(rng), StereoOdometry(machine.camera, settings)
    first_ns = round(1e9 * rng.uniform(0.0, path.duration_s - POSES_PER_RUN / RATE_HZ))
    stamps = [first_ns + round(1e9 * k / RATE_HZ) for k in range(POSES_PER_RUN + 1)]
    sights = [look(wall, true, path, t, told.sigma_px, readout_s, rng) for t in stamps]
    poses = [odometry.process_sight(sight) for sight in sights]
    Ts = np.array([path.pose_at(t) @ machine.T_tcp_cam_left for t in stamps])
    judged = judge(poses, inverse_pose(Ts[0]) @ Ts, [0.0] * len(poses), len(odometry.keyframes))
    used = np.array([status is not OdometryStatus.LOST for status in judged.statuses])
    used[0] = False
    return {
        "seed": seed,
        "distance_m": distance_m,
        "n_keyframes": len(odometry.keyframes),
        "n_lost": int(np.sum(~used)) - 1,
        "position_chi2": [round(float(value), 4) for value in judged.position_chi2[used]],
        "rotation_chi2": [round(float(value), 4) for value in judged.rotation_chi2[used]],
    }


def held(squares: Array, share: float = 0.95) -> float:
    """Share of chi2 values of 3 degrees of freedom inside the ellipsoid of this probability."""
    return float((squares < chi2.ppf(share, 3)).mean())
