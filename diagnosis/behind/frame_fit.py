"""A tracker's frame and points' places on their links, both unknown, by least squares: the global minimum.

Model: R p_i + t = R_i x_k + d_i. For any R the best t and x_k are linear in it, and what is left is a quadratic form of
       R's nine entries: minimised over rotations from many starts, which costs next to nothing.
Why:   frame and places by turns settled after a hundred rounds at millimetres, not at the noise, or stayed in another
       minimum, 0.8 m off: a healthy crane of three joints was refused for it.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.frame_descent import CURVATURE_MIN_FRAC, gauss_newton_rotations
from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec, skew

TRIED, SETTLED = 8, 40  # steps from every start, and from the best of them
POLISH_ITERATIONS = 3
ROTATION_GENERATORS = np.array([skew(axis) for axis in np.eye(3)])


@dataclass(frozen=True, slots=True)
class QuadraticForm:
    """Sum of squares r'Qr - 2 g'r + c [m^2] of R's entries r (9,), column by column."""

    Q: Array
    g: Array


def frame_and_places(
    R: Array, d: Array, xyz: Array, which: NDArray[np.int64], places: Array, known: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """T_base_tracker (4, 4) and places (k, 3) that bring measured points nearest to the arm.

    Args: R (m, 3, 3), d (m, 3): T_base_link of each point's link; xyz (m, 3) measured; which (m,) point each is;
          places (k, 3): those that are known.
    """
    d = d + np.where(known[which][:, None], np.einsum("mij,mj->mi", R, places[which]), 0.0)
    p0, d0 = xyz.mean(axis=0), d.mean(axis=0)
    p, d = xyz - p0, d - d0
    H = np.zeros((12, 12))
    H[:9, :9] = np.kron(p.T @ p, np.eye(3))
    H[9:, 9:] = len(p) * np.eye(3)
    H[:9, 9:] = np.kron(p.sum(axis=0)[:, None], np.eye(3))
    H[9:, :9] = H[:9, 9:].T
    b = np.concatenate([(p.T @ d).ravel(), d.sum(axis=0)])
    on_link: dict[int, tuple[Array, Array]] = {}  # a place is its D (r, t) - e
    for k in np.unique(which[~known[which]]):
        own = which == k
        n = int(own.sum())
        turned = np.einsum("ma,mji->iaj", p[own], R[own]).reshape(3, 9) / n
        D = np.concatenate([turned, R[own].mean(axis=0).T], axis=1)
        e = np.einsum("mji,mj->i", R[own], d[own]) / n
        H -= n * D.T @ D
        b -= n * D.T @ e
        on_link[int(k)] = (D, e)
    tt = np.linalg.pinv(H[9:, 9:], rcond=CURVATURE_MIN_FRAC, hermitian=True)
    form = QuadraticForm(H[:9, :9] - H[:9, 9:] @ tt @ H[9:, :9], b[:9] - H[:9, 9:] @ tt @ b[9:])
    found = best_rotation(form)
    r = found.T.ravel()
    t = tt @ (b[9:] - H[9:, :9] @ r)
    out = places.copy()
    for k, (D, e) in on_link.items():
        # both centres are taken off again: the frame's own shift is t + d0 - R p0
        out[k] = D @ np.concatenate([r, t]) - e
    return pose(found, t + d0 - found @ p0), out


def best_rotation(form: QuadraticForm) -> Array:
    """The rotation (3, 3) of the least sum of squares: damped Gauss-Newton from the cube's 24, the best to its end."""
    R, value = gauss_newton_rotations(form.Q, form.g, START_ROTATIONS, TRIED)
    best, _ = gauss_newton_rotations(form.Q, form.g, R[np.argmin(value)][None], SETTLED)
    return _refine_by_newton(form, best[0])


def _refine_by_newton(form: QuadraticForm, R: Array) -> Array:
    """A rotation (3, 3) by plain Newton steps: values of the form no longer show which is better there.

    Why: a residual that is left makes Gauss-Newton slow, and derivatives of the fit are taken by small differences.
    """
    twice = np.einsum("aij,bjk->abik", ROTATION_GENERATORS, ROTATION_GENERATORS)
    twice = 0.5 * (twice + twice.transpose(1, 0, 2, 3))
    for _ in range(POLISH_ITERATIONS):
        J = np.einsum("aij,jk->kia", ROTATION_GENERATORS, R).reshape(9, 3)
        pull = form.Q @ R.T.ravel() - form.g
        A = J.T @ form.Q @ J + np.einsum("ik,abij,jk->ab", pull.reshape(3, 3).T, twice, R)
        if np.linalg.eigvalsh(A)[0] <= CURVATURE_MIN_FRAC * np.trace(A):
            break
        R = rotation_from_rotvec(-np.linalg.solve(A, J.T @ pull)) @ R
    return R


def _cube_rotations() -> Array:
    """The 24 rotations of a cube: no rotation is farther than 63 degrees from one of them."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            R[range(3), order] = signs
            if np.linalg.det(R) > 0.0:
                found.append(R)
    return np.array(found)


START_ROTATIONS = _cube_rotations()
