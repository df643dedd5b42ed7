"""Compiled 3x3 to 6x6 algebra for the fits: no library calls, so that it compiles and runs fast."""

import math

import numpy as np
from numba import njit

from server.vision.contracts import Array


@njit(cache=True, nogil=True)
def solve_positive(matrix: Array, right: Array) -> Array:
    """x of matrix x = right for a symmetric positive definite matrix (n, n), by Cholesky; zeros where it is not."""
    n = len(right)
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i == j:
                if not value > 0.0:
                    return np.zeros(n)
                lower[i, i] = math.sqrt(value)
            else:
                lower[i, j] = value / lower[j, j]
    x = np.zeros(n)
    for i in range(n):
        value = right[i]
        for k in range(i):
            value -= lower[i, k] * x[k]
        x[i] = value / lower[i, i]
    for i in range(n - 1, -1, -1):
        value = x[i]
        for k in range(i + 1, n):
            value -= lower[k, i] * x[k]
        x[i] = value / lower[i, i]
    return x


@njit(cache=True, nogil=True)
def multiply(a: Array, b: Array) -> Array:
    """Product of two 3x3 matrices."""
    product = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            product[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return product


@njit(cache=True, nogil=True)
def apply(matrix: Array, vector: Array) -> Array:
    """3x3 matrix times vector (3,)."""
    result = np.zeros(3)
    for i in range(3):
        result[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]
    return result


@njit(cache=True, nogil=True)
def rotated_by_rotvec(rotation: Array, rotvec: Array) -> Array:
    """exp(rotvec) @ rotation, Rodrigues with its series below 1e-9 rad."""
    angle = math.sqrt(rotvec[0] ** 2 + rotvec[1] ** 2 + rotvec[2] ** 2)
    first, second = 1.0, 0.5
    if angle > 1e-9:
        first, second = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    k = np.zeros((3, 3))
    k[0, 1], k[0, 2], k[1, 2] = -rotvec[2], rotvec[1], -rotvec[0]
    k[1, 0], k[2, 0], k[2, 1] = rotvec[2], -rotvec[1], rotvec[0]
    squared = multiply(k, k)
    exponential = np.zeros((3, 3))
    for i in range(3):
        exponential[i, i] = 1.0
        for j in range(3):
            exponential[i, j] += first * k[i, j] + second * squared[i, j]
    return multiply(exponential, rotation)
