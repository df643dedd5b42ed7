"""What a set of vectors says about a rotation: its information, and how even that is over the axes."""

import numpy as np

from server.calibration.contracts import Array


def rotation_information(vectors: Array, weights: Array) -> Array:
    """Information of paired vectors about a small rotation, per unit variance.

    Model:   A = sum w (|v|^2 I - v v^T): weak about the direction most vectors share.
    Args:    vectors (k, 3) [m]; weights (k,).
    Returns: (3, 3) [m^2].
    """
    squares = float(np.sum(weights * np.sum(vectors**2, axis=1)))
    return squares * np.eye(3) - (vectors * weights[:, None]).T @ vectors


def observability(information: Array) -> float:
    """Smallest eigenvalue over the largest, 0..1: 0 for a straight line, 1 for equal knowledge about all axes."""
    values = np.linalg.eigvalsh(information)
    return float(max(values[0], 0.0) / values[2]) if values[2] > 0.0 else 0.0
