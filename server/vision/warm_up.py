"""Compiles the numeric kernels before the first pair; a cold start costs seconds, later ones find the cache."""

import numpy as np

from machine.poses import pose
from server.vision.border_fit import border_covered, printed_pattern, sides_without_margin
from server.vision.charuco_saddle import fit_saddles
from server.vision.edge_fit import fit_corners
from server.vision.marker_search import wrong_cells
from server.vision.pose_refinement import PointObservations, refine_pose


def warm_up_markers() -> None:
    """Run the marker kernels on a drawn square."""
    image = np.full((64, 64), 220, np.uint8)
    image[16:48, 16:48] = 20
    square = np.array([[16.0, 16.0], [47.0, 16.0], [47.0, 47.0], [16.0, 47.0]])
    fit_corners(image, square, 6, np.zeros(4))
    wrong_cells(image, square, np.zeros((6, 6), dtype=np.bool_))
    border_covered(image, square, printed_pattern(np.eye(6, dtype=np.bool_)))
    sides_without_margin(image, square, np.eye(6, dtype=np.bool_))
    points = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    start = pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 5.0]))
    refine_pose(start, PointObservations(points, 100.0 * points[:, :2], np.zeros(4), np.array([500.0, 500.0])))


def warm_up_boards() -> None:
    """Run the chess corner kernel on a drawn corner."""
    image = np.full((64, 64), 220, np.uint8)
    image[:32, :32] = image[32:, 32:] = 20
    fit_saddles(image, np.full((1, 2), 31.5), 16.0 * np.eye(2)[None], np.ones(1, dtype=np.bool_), 0.2)
