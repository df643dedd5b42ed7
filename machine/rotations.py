"""SO(3): rotation vectors, quaternions (wxyz) and the geodesic angle, all on plain arrays."""

import numpy as np
from numpy.typing import NDArray

from machine.errors import MachineError

Array = NDArray[np.float64]


def skew(vector: Array) -> Array:
    """Cross-product matrix: `skew(a) @ b == cross(a, b)`. Args: vector (3,). Returns: (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def skew_matrices(vectors: Array) -> Array:
    """`skew` of vectors (n, 3): (n, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def rotation_from_rotvec(rotvec: Array) -> Array:
    """Rotation matrix of a rotation vector (Rodrigues).

    Model:   R = I + sin(t)/t K + (1 - cos t)/t^2 K^2, K = skew(rotvec), t = |rotvec|; series below 1e-8.
    Args:    rotvec: axis times angle, shape (3,), unit [rad].
    Returns: rotation, shape (3, 3).
    """
    angle = float(np.linalg.norm(rotvec))
    k = skew(np.asarray(rotvec, dtype=float))
    if angle < 1e-8:
        return np.eye(3) + k + 0.5 * k @ k
    return np.eye(3) + (np.sin(angle) / angle) * k + ((1.0 - np.cos(angle)) / angle**2) * k @ k


def quat_wxyz_from_rotation(rotation: Array) -> Array:
    """Unit quaternion (w, x, y, z) with w >= 0, by the largest-component branch. Args: (3, 3). Returns: (4,)."""
    r = rotation
    squares = np.array(
        [
            1.0 + r[0, 0] + r[1, 1] + r[2, 2],
            1.0 + r[0, 0] - r[1, 1] - r[2, 2],
            1.0 - r[0, 0] + r[1, 1] - r[2, 2],
            1.0 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    i = int(np.argmax(squares))
    products = np.array(
        [
            [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], squares[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], squares[2], r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[3]],
        ]
    )
    quat = products[i] / np.linalg.norm(products[i])
    return quat if quat[0] >= 0.0 else -quat


def rotation_from_quat_wxyz(quat_wxyz: Array) -> Array:
    """Rotation matrix of a quaternion (w, x, y, z); normalised on the way in. Args: (4,). Returns: (3, 3)."""
    norm = float(np.linalg.norm(quat_wxyz))
    if not norm > 0.0:
        raise MachineError(f"quaternion is {quat_wxyz}; give four finite numbers (w, x, y, z), not all 0")
    w, x, y, z = np.asarray(quat_wxyz, dtype=float) / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotvec_from_rotation(rotation: Array) -> Array:
    """Rotation vector of a rotation matrix; exact near 0 and near pi (goes through the quaternion).

    Args:    rotation: (3, 3).
    Returns: axis times angle in [0, pi], shape (3,), unit [rad].
    """
    quat = quat_wxyz_from_rotation(rotation)
    sine = float(np.linalg.norm(quat[1:]))
    if sine < 1e-12:
        return 2.0 * quat[1:]
    return quat[1:] * (2.0 * np.arctan2(sine, quat[0]) / sine)


def geodesic_angle(rotation_a: Array, rotation_b: Array) -> float:
    """Angle between two rotations [rad], in [0, pi]."""
    return float(np.linalg.norm(rotvec_from_rotation(rotation_a.T @ rotation_b)))


def rotation_about(axis: str, angle_rad: float) -> Array:
    """Elementary rotation about "x", "y" or "z" [rad]. Returns: (3, 3)."""
    if axis not in ("x", "y", "z"):
        raise MachineError(f"axis is {axis!r}; give 'x', 'y' or 'z'")
    return rotation_from_rotvec(np.eye(3)["xyz".index(axis)] * angle_rad)


def nearest_rotation(matrix: Array) -> Array:
    """Rotation closest to a 3x3 matrix in the Frobenius norm (SVD, determinant +1)."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
