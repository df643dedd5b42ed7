"""Steps of a bundle's bodies and points, and the priors on its bodies."""

import math

import numpy as np
from numba import njit

from server.vision.bundle_layout import BundleLayout, BundleState, BundleWork
from server.vision.contracts import Array
from server.vision.small_algebra import multiply, rotated

SHRINK_MIN = -0.9  # of the relative inverse depth in one step: no point jumps behind its anchor


@njit(cache=True, nogil=True)
def move(layout: BundleLayout, state: BundleState, work: BundleWork, step: Array, trial: BundleState) -> None:
    """Write the moved state into `trial`: bodies by R <- exp(w) R, t <- t + dt, points in their charts."""
    for body in range(len(layout.column)):
        column = layout.column[body]
        if column < 0:
            trial.rotation[body] = state.rotation[body]
            trial.position[body] = state.position[body]
            continue
        part = step[6 * column : 6 * column + 6]
        trial.rotation[body] = rotated(state.rotation[body], part[:3])
        for j in range(3):
            trial.position[body, j] = state.position[body, j] + part[3 + j]
    for p in range(len(layout.body)):
        if work.anchor[p] >= 0:
            _move_point(state, work, p, trial)
        elif layout.body[p] >= 0:
            _place_in_body(layout, p, trial)
        else:
            trial.points[p] = state.points[p]


@njit(cache=True, nogil=True)
def _move_point(state: BundleState, work: BundleWork, p: int, trial: BundleState) -> None:
    eye, M, d = state.position[work.anchor[p]], work.chart[p], work.point_step[p]
    shrink = 1.0 / (1.0 + max(d[2], SHRINK_MIN))
    for j in range(3):  # the chart's third column is minus the arm
        trial.points[p, j] = eye[j] + (M[j, 0] * d[0] + M[j, 1] * d[1] - M[j, 2]) * shrink


@njit(cache=True, nogil=True)
def _place_in_body(layout: BundleLayout, p: int, trial: BundleState) -> None:
    body, q = layout.body[p], layout.in_body[p]
    for j in range(3):
        R = trial.rotation[body, j]
        trial.points[p, j] = trial.position[body, j] + R[0] * q[0] + R[1] * q[1] + R[2] * q[2]


@njit(cache=True, nogil=True)
def prior_errors(start: BundleState, state: BundleState, body: int) -> Array:
    """Way from the start (6,): log(R R_start^T) and t - t_start."""
    away = multiply(state.rotation[body], start.rotation[body].T)
    error = np.zeros(6)
    error[0] = 0.5 * (away[2, 1] - away[1, 2])
    error[1] = 0.5 * (away[0, 2] - away[2, 0])
    error[2] = 0.5 * (away[1, 0] - away[0, 1])
    sine = math.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
    cosine = 0.5 * (away[0, 0] + away[1, 1] + away[2, 2] - 1.0)
    if sine > 1e-9:
        for j in range(3):
            error[j] *= math.atan2(sine, cosine) / sine
    for j in range(3):
        error[3 + j] = state.position[body, j] - start.position[body, j]
    return error


@njit(cache=True, nogil=True)
def priors_cost(layout: BundleLayout, start: BundleState, state: BundleState) -> float:
    """Half of the squared Mahalanobis way from the start, over all bodies with a prior."""
    cost = 0.0
    for body in range(len(layout.column)):
        if layout.has_prior[body]:
            error = prior_errors(start, state, body)
            for j in range(6):
                for q in range(6):
                    cost += 0.5 * error[j] * layout.information[body, j, q] * error[q]
    return cost


@njit(cache=True, nogil=True)
def add_priors(layout: BundleLayout, start: BundleState, state: BundleState, work: BundleWork) -> None:
    """Clear the reduced system and write the priors into it."""
    work.reduced[:] = 0.0
    work.right[:] = 0.0
    work.diagonal[:] = 0.0
    for body in range(len(layout.column)):
        if not layout.has_prior[body]:
            continue
        o, error = 6 * layout.column[body], prior_errors(start, state, body)
        J = np.eye(6)
        _inverse_left_jacobian(error[:3], J)
        weighted = J.T @ layout.information[body]
        own, pull = weighted @ J, weighted @ error
        for j in range(6):
            work.right[o + j] += pull[j]
            work.diagonal[o + j] += own[j, j]
            for q in range(j + 1):
                work.reduced[o + j, o + q] += own[j, q]


@njit(cache=True, nogil=True)
def _inverse_left_jacobian(rotvec: Array, J: Array) -> None:
    """d log(exp(w) R) / dw at w = 0 into the upper left of J: 1 - [phi]x / 2 + k [phi]x^2 (Chirikjian 2012, 10.86)."""
    angle = math.sqrt(rotvec[0] ** 2 + rotvec[1] ** 2 + rotvec[2] ** 2)
    k = 1.0 / 12.0 + angle * angle / 720.0
    if angle > 1e-3:
        k = 1.0 / (angle * angle) - (1.0 + math.cos(angle)) / (2.0 * angle * math.sin(angle))
    cross = np.zeros((3, 3))
    cross[0, 1], cross[0, 2], cross[1, 2] = -rotvec[2], rotvec[1], -rotvec[0]
    cross[1, 0], cross[2, 0], cross[2, 1] = rotvec[2], -rotvec[1], rotvec[0]
    squared = multiply(cross, cross)
    for j in range(3):
        for q in range(3):
            J[j, q] += k * squared[j, q] - 0.5 * cross[j, q]
