"""More than one rigid motion in a pair: each is found, and then which of them is the world's.

A boom or a hose in the picture moves with the camera, a hand or a person by itself: its points agree with each other
as well as the wall's do, so no residual says which of the motions is the camera's through the world.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.poses import transform_points
from server.vision.contracts import Array
from server.vision.odometry_features import N_IMAGE_CELLS, cell_numbers, covered_cell_count
from server.vision.odometry_motion import Twist
from server.vision.odometry_observation import ObservedPoints
from server.vision.odometry_pose import PoseFit, PoseProblem, minimise, normal_equations, rough_pose, settled_pose

RANSAC_SAMPLE_SIZE = 3  # points that determine a pose, seen by both eyes
SAMPLE_FIT_ITERATIONS = 5
RANSAC_CONFIDENCE = 0.999  # that one sample held points of one motion only
RANSAC_SAMPLES_MAX = 250  # for a share of 30 %
MOTIONS_MAX = 3
QUADRATIC_LOSS_LIMIT = -1e12  # Cauchy size at which every point of a sample counts fully
STILL_SPLIT_ITERATIONS = 5
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class LocatedPose:
    """A pose, the points that it was fitted to (as shifted for the shutter), the velocity that was assumed, and what is
    left of each point if it moved with the camera instead.

    rival_fit: of another motion that may be the world's as well; the covariance holds both. doubt_reason: why the pose
    may be quite another one, or "". lookalike_covariance_m2 (3, 3): in vo, of the places that look alike.
    jumped_to_lookalike: without motion.
    """

    observed_points: ObservedPoints
    fit: PoseFit
    points_vo: Array
    twist: Twist
    rest_squares: Array
    rival_fit: PoseFit | None = None
    doubt_reason: str = ""
    lookalike_covariance_m2: Array = field(default_factory=lambda: np.zeros((3, 3)))
    jumped_to_lookalike: bool = False


@dataclass(frozen=True, slots=True)
class Scene:
    """What distinguishes motions, of n points: left_px (n, 2), raw; rest_squares (n,): squared whitened residuals as if
    they had moved with the camera since they were kept; motion_votes (n,), earlier: above 0 it went with the world,
    below with the camera; points_vo (n, 3); noise_factor: as `PoseProblem`.

    count_good, coverage_good: from so many points, in so many cells of the picture, a motion could be the world's.
    """

    left_px: Array
    rest_squares: Array
    motion_votes: NDArray[np.int8]
    points_vo: Array
    noise_factor: float
    image_shape: tuple[int, int]
    count_good: int
    coverage_good: int


@njit(cache=True, nogil=True)
def _best_sample(
    rotation: Array, position: Array, points: Array, rays: Array, roots: Array, shape: Array, limit: float, draws: Array
) -> tuple[Array, Array]:
    """Rotation and position by the sample (row of `draws`) with the least truncated cost over all points."""
    best = limit * len(points)
    found_rotation, found_position = rotation, position
    needed = len(draws)
    for k in range(len(draws)):
        if k >= needed:
            break
        a, b, c = draws[k]
        if a in (b, c) or b == c:
            continue
        some = draws[k]
        tried = minimise(
            rotation,
            position,
            points[some],
            rays[some],
            roots[some],
            shape,
            QUADRATIC_LOSS_LIMIT,
            SAMPLE_FIT_ITERATIONS,
        )
        _, _, cost, squares = normal_equations(tried[0], tried[1], points, rays, roots, shape, limit)
        if cost < best:
            best = cost
            found_rotation, found_position = tried[0], tried[1]
            share = (squares < limit).sum() / len(points)
            if share > 0.0:
                wrong = max(1.0 - share**RANSAC_SAMPLE_SIZE, 1e-12)
                needed = (
                    min(needed, int(math.log(1.0 - RANSAC_CONFIDENCE) / math.log(wrong)) + 1) if wrong < 1.0 else needed
                )
    return found_rotation, found_position


def find_motions(problem: PoseProblem, first: PoseFit, needed: int) -> list[PoseFit]:
    """All motions that at least `needed` points of their own agree with, the given one first.

    Model:   sequential RANSAC with the truncated cost of MSAC and a fixed scale: what no motion explains yet gives
             samples of 3 points; the best sample is fitted to all points that agree with it.
    Source:  Torr and Zisserman 2000 (MSAC); Chum, Matas and Kittler 2003 (LO-RANSAC).
    """
    found, left = [first], ~first.inliers & (problem.whitening_matrices[:, 0, 0] > 0.0)
    rng = np.random.default_rng(1)
    while len(found) < MOTIONS_MAX and left.sum() >= needed:
        on = np.flatnonzero(left)
        data = problem.points[on], problem.rays[on], problem.whitening_matrices[on], problem.focal_and_baseline
        rotation = np.ascontiguousarray(first.T_cam_vo[:3, :3])
        position = np.ascontiguousarray(first.T_cam_vo[:3, 3])
        draws = rng.integers(0, len(on), (RANSAC_SAMPLES_MAX, RANSAC_SAMPLE_SIZE))
        fit = settled_pose(problem, *_best_sample(rotation, position, *data, problem.limit, draws))
        if fit is None or (fit.inliers & left).sum() < needed:
            break
        found.append(fit)
        left = left & ~fit.inliers
    return found


def _fit_of(problem: PoseProblem, T_cam_vo: Array) -> PoseFit | None:
    return settled_pose(problem, *rough_pose(problem, T_cam_vo))


def part_motions(problem: PoseProblem, fit: PoseFit, scene: Scene, needed: int) -> tuple[list[PoseFit], bool]:
    """The motion of one part of the picture and the rest of the other, and whether they are surely two.

    Model:   two motions that differ by less than the inliers' limit pass for one. But one of them is known beforehand:
             none at all, of own structure or of a world before a standing camera. Cells of the picture that moved less
             than its mean are given to rest, then each of 40 cells to rest or to the fit of the others, whichever
             leaves less, until nothing changes. They are two if that explains more than labels may by chance (a bit
             for each cell: minimum description length).
    Returns: nothing where either part has less than `needed` points.
    """
    at_rest = np.minimum(scene.rest_squares, problem.limit)
    if (at_rest < problem.limit).sum() < needed:
        return [], False
    cells, moving = cell_numbers(scene.left_px, scene.image_shape), fit
    on = (np.bincount(cells, at_rest - at_rest.mean(), N_IMAGE_CELLS) < 0.0)[cells]
    squares = single = np.minimum(fit.squared_residuals, problem.limit)
    for _ in range(STILL_SPLIT_ITERATIONS):
        again = _fit_of(problem.without_points(on), fit.T_cam_vo)
        if again is None:
            return [], False
        moving, squares, before = again, np.minimum(problem.squares(again.T_cam_vo), problem.limit), on
        on = (np.bincount(cells, squares - at_rest, N_IMAGE_CELLS) > 0.0)[cells]
        if (on == before).all():
            break
    resting = _fit_of(problem.without_points(~on), fit.T_cam_vo)
    if resting is None or min(resting.inliers.sum(), moving.inliers.sum()) < needed:
        return [], False
    gained = (single.sum() - squares[~on].sum() - at_rest[on].sum()) / problem.noise_factor**2
    whole = [replace(part, squared_residuals=problem.squares(part.T_cam_vo)) for part in (moving, resting)]
    return whole, bool(gained > 2.0 * np.log(2.0) * N_IMAGE_CELLS)


@dataclass(frozen=True, slots=True)
class _MotionHypothesis:
    """One motion and the points that only it explains. is_still: it moved them
    in the picture by less than the noise."""

    fit: PoseFit
    n_points: int
    n_cells: int
    is_still: bool
    mean_vote: float
    depth_m: float
    may_be_world: bool


def _evidence_for_fit(fit: PoseFit, other: PoseFit, scene: Scene) -> _MotionHypothesis:
    on = fit.inliers & ~other.inliers
    count, spread = int(on.sum()), covered_cell_count(scene.left_px[on], scene.image_shape)
    depths = transform_points(fit.T_cam_vo, scene.points_vo[on])[:, 2]
    gained = np.sum(np.minimum(scene.rest_squares[on], fit.inlier_limit) - fit.squared_residuals[on])
    return _MotionHypothesis(
        fit=fit,
        n_points=count,
        n_cells=spread,
        is_still=count > 0 and bool(gained < 4.0 * count * scene.noise_factor**2),
        mean_vote=float(np.sign(scene.motion_votes[on]).mean()) if count else 0.0,
        depth_m=float(np.median(depths)) if count else 0.0,
        may_be_world=count >= scene.count_good and spread >= scene.coverage_good,
    )


def world_motion(fits: Sequence[PoseFit], scene: Scene) -> tuple[PoseFit, PoseFit | None, str]:
    """Which of the motions is the camera's through the world; a rival where nothing decides, and why it is doubtful."""
    world, rival, doubt = fits[0], None, ""
    for fit in fits[1:]:
        won, lost, why = _choose_world_motion(
            _evidence_for_fit(world, fit, scene), _evidence_for_fit(fit, world, scene), scene
        )
        if why or lost is rival:
            rival, doubt = (lost, why) if why else (None, "")
        world = won
    return world, rival, doubt


def _choose_world_motion(one: _MotionHypothesis, two: _MotionHypothesis, scene: Scene) -> tuple[PoseFit, PoseFit, str]:
    """Winner, loser, and why that is doubtful: by what earlier motion showed, then by the picture.

    Own structure stands still in the picture while the world behind it moves; a thing that moves by itself does so in
    front of a world at rest. So where one side stands still the farther one is the world, in doubt where it spreads
    less. Where that does not decide, the larger spread wins, in doubt where the other is large enough to be the world.
    """
    if abs(one.mean_vote - two.mean_vote) > 0.5:  # more than half of the points of either side are known
        return (one.fit, two.fit, "") if one.mean_vote > two.mean_vote else (two.fit, one.fit, "")
    large, small = (one, two) if (one.n_cells, one.n_points) >= (two.n_cells, two.n_points) else (two, one)
    before = small.depth_m < large.depth_m
    if before if one.is_still != two.is_still else not small.may_be_world:
        return large.fit, small.fit, ""
    return (
        large.fit,
        small.fit,
        (
            f"two motions in the picture, {large.n_points} points in {large.n_cells} of 40 cells and {small.n_points} "
            f"in {small.n_cells}; mask what moves with the camera, or clear the view"
        ),
    )
