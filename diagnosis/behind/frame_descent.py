"""A quadratic form of a rotation's entries, downhill from many starts: compiled, for it is asked thousands of times."""

import math

import numpy as np
from numba import njit

from machine.rotations import Array

CURVATURE_MIN_FRAC = 1e-10  # of the largest curvature: along less than that nothing is known, and nothing is changed
CONVERGENCE_STEP_RAD = 1e-11


@njit(cache=True)
def gauss_newton_rotations(Q: Array, g: Array, starts: Array, steps: int) -> tuple[Array, Array]:
    """Rotations (s, 3, 3) after so many damped Gauss-Newton steps from each start, and r'Qr - 2 g'r (s,) there.

    Args: Q (9, 9), g (9,): the form of the rotation's entries, column by column; starts (s, 3, 3).
    """
    found = starts.copy()
    values = np.empty(len(starts))
    moved = np.empty((3, 3))
    J = np.empty((9, 3))
    A = np.empty((3, 3))
    slope = np.empty(3)
    for s in range(len(starts)):
        R = found[s]
        value, pull = _form_value_and_gradient(Q, g, R)
        damping = 1e-3
        for _ in range(steps):
            for k in range(3):
                x, y, z = R[0, k], R[1, k], R[2, k]
                J[3 * k, 0], J[3 * k + 1, 0], J[3 * k + 2, 0] = 0.0, -z, y  # each axis crossed with the column
                J[3 * k, 1], J[3 * k + 1, 1], J[3 * k + 2, 1] = z, 0.0, -x
                J[3 * k, 2], J[3 * k + 1, 2], J[3 * k + 2, 2] = -y, x, 0.0
            for a in range(3):
                slope[a] = 0.0
                for i in range(9):
                    slope[a] += J[i, a] * pull[i]
                for b in range(a, 3):
                    A[a, b] = 0.0
                    for i in range(9):
                        row = 0.0
                        for j in range(9):
                            row += Q[i, j] * J[j, b]
                        A[a, b] += J[i, a] * row
                    A[b, a] = A[a, b]
            ridge = max(damping, CURVATURE_MIN_FRAC) * ((A[0, 0] + A[1, 1] + A[2, 2]) / 3.0 + 1e-300)
            for a in range(3):
                A[a, a] += ridge
            x, y, z = _solve_symmetric_3x3(A, slope)
            _rotate_by_rotvec(-x, -y, -z, R, moved)
            new, new_pull = _form_value_and_gradient(Q, g, moved)
            if new <= value:
                R[:] = moved
                value, pull, damping = new, new_pull, 0.1 * damping
            else:
                damping *= 10.0
            if max(abs(x), abs(y), abs(z)) < CONVERGENCE_STEP_RAD:
                break
        values[s] = value
    return found, values


@njit(cache=True)
def _form_value_and_gradient(Q: Array, g: Array, R: Array) -> tuple[float, Array]:
    """The form at R (3, 3), and half its derivative (9,) by R's entries."""
    pull = np.empty(9)
    value = 0.0
    for i in range(9):
        total = 0.0
        for j in range(9):
            total += Q[i, j] * R[j % 3, j // 3]
        pull[i] = total - g[i]
        value += R[i % 3, i // 3] * (total - 2.0 * g[i])
    return value, pull


@njit(cache=True)
def _solve_symmetric_3x3(A: Array, b: Array) -> tuple[float, float, float]:
    """x of A x = b for a symmetric A (3, 3), by cofactors; zeros where it has no inverse."""
    c0 = A[1, 1] * A[2, 2] - A[1, 2] * A[1, 2]
    c1 = A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c2 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    det = A[0, 0] * c0 + A[0, 1] * c1 + A[0, 2] * c2
    if not abs(det) > 0.0:
        return 0.0, 0.0, 0.0
    c11 = A[0, 0] * A[2, 2] - A[0, 2] * A[0, 2]
    c12 = A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
    return (
        (c0 * b[0] + c1 * b[1] + c2 * b[2]) / det,
        (c1 * b[0] + c11 * b[1] + c12 * b[2]) / det,
        (c2 * b[0] + c12 * b[1] + c22 * b[2]) / det,
    )


@njit(cache=True)
def _rotate_by_rotvec(x: float, y: float, z: float, R: Array, out: Array) -> None:
    """R (3, 3) turned by a rotation vector [rad] (Rodrigues), into `out`."""
    angle = math.sqrt(x * x + y * y + z * z)
    along = math.sin(angle) / angle if angle > 1e-9 else 1.0
    half = math.sin(0.5 * angle) / (0.5 * angle) if angle > 1e-9 else 1.0
    about = 0.5 * half * half
    for k in range(3):
        u, v, w = R[0, k], R[1, k], R[2, k]
        p, q, r = y * w - z * v, z * u - x * w, x * v - y * u
        out[0, k] = u + along * p + about * (y * r - z * q)
        out[1, k] = v + along * q + about * (z * p - x * r)
        out[2, k] = w + along * r + about * (x * q - y * p)
