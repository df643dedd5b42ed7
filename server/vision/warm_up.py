"""Compiles the numeric kernels before the first pair; a cold start costs seconds, later ones find the cache."""

import numpy as np

from machine.poses import pose
from server.vision.edge_fit import fit_corners
from server.vision.odometry_align import align
from server.vision.odometry_pose import StereoPoints, refine_camera
from server.vision.pose_refinement import PointObservations, refine_pose


def warm_up_markers() -> None:
    """Run the marker kernels on a drawn square."""
    image = np.full((64, 64), 220, np.uint8)
    image[16:48, 16:48] = 20
    square = np.array([[16.0, 16.0], [47.0, 16.0], [47.0, 47.0], [16.0, 47.0]])
    fit_corners(image, square, 6, np.zeros(4))
    points = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    start = pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 5.0]))
    refine_pose(start, PointObservations(points, 100.0 * points[:, :2], np.zeros(4), np.array([500.0, 500.0])))


def warm_up_odometry() -> None:
    """Run the odometry kernels on random texture."""
    rng = np.random.default_rng(1)
    image = rng.integers(0, 255, (48, 48)).astype(np.uint8)
    middle = np.array([[24.0, 24.0]])
    align(image, middle, np.eye(2)[None], image, middle)
    points = rng.uniform(-1.0, 1.0, (12, 3)) + np.array([0.0, 0.0, 5.0])
    rays = points[:, :2] / points[:, 2:]
    refine_camera(np.eye(4), StereoPoints(points, rays, rays, np.ones((12, 2)), 500.0, 0.1))
