"""Which set of effects a linear model supports best: spike and slab over subsets.

Model:  y = J x + e, e ~ N(0, I); a term is in the set (slab, x_j ~ N(0, slab_j^2)) or not (spike, x_j = 0).
        The evidence of a set has a closed form, so sets are compared without sampling.
Search: from the whole set downwards, then by the best of all additions, removals and exchanges.
Source: George, McCulloch 1993 (spike and slab).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.rotations import Array

BOUND_PENALTY_NATS = 7.0  # price of a number that would be negative and cannot: the set without it is always better
EXCHANGE_TRIALS_MAX = 200  # exchanges that are tried with the bounds
Members = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class LinearProblem:
    """`normal_matrix` J'J (k, k), `normal_rhs` J'y (k,), `prior_sigma` (k,): the slabs.

    `term_first_column`: (terms + 1,), a term owns the columns up to the next one's first.
    `nonnegative`: (k,), columns whose number cannot be negative. `log_odds`: (terms,), prior, of a term being there.
    """

    normal_matrix: Array
    normal_rhs: Array
    prior_sigma: Array
    term_first_column: NDArray[np.int64]
    nonnegative: Members
    log_odds: Array

    @property
    def term_count(self) -> int:
        """Number of terms."""
        return len(self.log_odds)

    def score(self, members: Members) -> float:
        """Log posterior of a set, up to a constant [nats]."""
        return float(
            _subset_score(
                self.normal_matrix,
                self.normal_rhs,
                self.prior_sigma,
                self.term_first_column,
                self.nonnegative,
                self.log_odds,
                members,
            )
        )

    def estimate(self, members: Members) -> tuple[Array, Array]:
        """x (k,), zero outside the set, and its covariance (k, k)."""
        cols = np.nonzero(np.repeat(members, np.diff(self.term_first_column)))[0]
        kept, x = _solve_bounded_subset(self.normal_matrix, self.normal_rhs, self.prior_sigma, self.nonnegative, cols)[
            1:
        ]
        out, S = np.zeros(len(self.normal_rhs)), np.zeros_like(self.normal_matrix)
        out[kept] = x * self.prior_sigma[kept]
        own = np.ix_(kept, kept)
        S[own] = np.linalg.inv(self.normal_matrix[own] + np.diag(self.prior_sigma[kept] ** -2.0))
        return out, S

    def misfit_nats(self, x: Array) -> float:
        """1/2 |J x - y|^2 - 1/2 |y|^2 [nats]."""
        return float(0.5 * x @ self.normal_matrix @ x - self.normal_rhs @ x)


def best_set(problem: LinearProblem, start: Members, allowed: Members) -> Members:
    """The set at which no addition, removal or exchange of one term helps, from `start`; only `allowed` terms enter."""
    given = (
        problem.normal_matrix,
        problem.normal_rhs,
        problem.prior_sigma,
        problem.term_first_column,
        problem.nonnegative,
        problem.log_odds,
    )
    return np.asarray(_hill_climb_subset(*given, start & allowed, allowed))


def best_set_without(problem: LinearProblem, members: Members, term: int, allowed: Members) -> Members:
    """The best set of allowed terms that does not hold a term, from `members` without it."""
    others = allowed.copy()
    others[term] = False
    return best_set(problem, members, others)


def best_addition(problem: LinearProblem, members: Members, allowed: Members) -> Members | None:
    """A set with the one allowed term more that raises its score most; None where none raises it."""
    larger = [members | term for term in np.eye(problem.term_count, dtype=bool)[allowed]]
    best = max(larger, key=problem.score, default=members)
    return best if problem.score(best) > problem.score(members) else None


@njit(cache=True)
def _solve_bounded_subset(H, c, slab, nonnegative, cols):
    """Log evidence, columns kept and their numbers in slabs; a number below its bound of 0 stays there, at a price."""
    keep = np.ones(cols.shape[0], np.bool_)
    while True:
        own = cols[keep]
        m = own.shape[0]
        if m == 0:
            return -BOUND_PENALTY_NATS * cols.shape[0], own, np.zeros(0)
        A, b = np.empty((m, m)), np.empty(m)
        for i in range(m):
            b[i] = c[own[i]] * slab[own[i]]
            for j in range(m):
                A[i, j] = H[own[i], own[j]] * slab[own[i]] * slab[own[j]]
            A[i, i] += 1.0
        L = np.linalg.cholesky(A)
        z = np.linalg.solve(L, b)
        x = np.linalg.solve(L.T, z)
        worst, at = 0.0, -1
        for i in range(m):
            if nonnegative[own[i]] and x[i] < worst:
                worst, at = x[i], i
        if at < 0:
            value = 0.5 * np.sum(z * z) - BOUND_PENALTY_NATS * (cols.shape[0] - m)
            for i in range(m):
                value -= np.log(L[i, i])
            return value, own, x
        keep[np.nonzero(keep)[0][at]] = False


@njit(cache=True)
def _member_columns(first, members):
    """Columns of the members of a set."""
    out = np.empty(first[-1], np.int64)
    m = 0
    for t in range(members.shape[0]):
        if members[t]:
            for col in range(first[t], first[t + 1]):
                out[m] = col
                m += 1
    return out[:m]


@njit(cache=True)
def _subset_score(H, c, slab, first, nonnegative, log_odds, members):
    prior = 0.0
    for t in range(members.shape[0]):
        if members[t]:
            prior += log_odds[t]
    return prior + _solve_bounded_subset(H, c, slab, nonnegative, _member_columns(first, members))[0]


@njit(cache=True)
def _with_each(G, b, first, nonnegative, log_odds, P, own, members):
    """By how much each absent term would raise a set's score (terms,); own (k,): its columns, P (k, k): inverse.

    Model: G, b in slabs; a block U enters with 1/2 r' S^-1 r - 1/2 log |S|, S = G_UU + I - G_UO P G_OU,
           r = b_U - G_UO x.
    """
    terms, k = members.shape[0], own.shape[0]
    x = np.zeros(k)
    for i in range(k):
        for j in range(k):
            x[i] += P[i, j] * b[own[j]]
    out = np.full(terms, -np.inf)
    for t in range(terms):
        m = first[t + 1] - first[t]
        if members[t] or m == 0:
            continue
        S, r = np.empty((m, m)), np.empty(m)
        for i in range(m):
            u = first[t] + i
            row = np.zeros(k)
            r[i] = b[u]
            for q in range(k):
                g = G[u, own[q]]
                r[i] -= g * x[q]
                if g != 0.0:
                    for j in range(k):
                        row[j] += g * P[q, j]
            for j in range(m):
                S[i, j] = G[u, first[t] + j]
                for q in range(k):
                    S[i, j] -= row[q] * G[own[q], first[t] + j]
            S[i, i] += 1.0
        if m == 1 and nonnegative[first[t]] and r[0] < 0.0:
            out[t] = log_odds[t] - BOUND_PENALTY_NATS
            continue
        values, vectors = np.linalg.eigh(0.5 * (S + S.T))
        values = np.maximum(values, 1.0)  # less is rounding
        z = vectors.T @ r
        out[t] = log_odds[t] + 0.5 * np.sum(z * z / values) - 0.5 * np.sum(np.log(values))
    return out


@njit(cache=True)
def _in_slabs(H, c, slab, first, nonnegative, members):
    """G, b: H, c counted in slabs; the set's columns that are kept (k,), and the inverse of G + I over them (k, k)."""
    G, b = H * slab * slab.reshape(-1, 1), c * slab
    own = np.sort(_solve_bounded_subset(H, c, slab, nonnegative, _member_columns(first, members))[1])
    k = own.shape[0]
    A = np.empty((k, k))
    for i in range(k):
        for j in range(k):
            A[i, j] = G[own[i], own[j]]
        A[i, i] += 1.0
    return G, b, own, np.linalg.inv(A)


@njit(cache=True)
def _matrix_block(P, rows, cols):
    out = np.empty((rows.shape[0], cols.shape[0]))
    for i in range(rows.shape[0]):
        for j in range(cols.shape[0]):
            out[i, j] = P[rows[i], cols[j]]
    return out


@njit(cache=True)
def _flip_score_changes(G, b, first, nonnegative, log_odds, P, own, members):
    """By how much one term more or less changes the score of a set, by the linear model without bounds (terms,)."""
    out = _with_each(G, b, first, nonnegative, log_odds, P, own, members)
    x = P @ b[own]
    for t in range(members.shape[0]):
        if members[t]:
            out[t] = -log_odds[t]
            T = np.nonzero((own >= first[t]) & (own < first[t + 1]))[0]
            if T.shape[0] > 0:
                PTT = _matrix_block(P, T, T)
                out[t] -= 0.5 * (x[T] @ np.linalg.inv(PTT) @ x[T]) + 0.5 * np.log(max(np.linalg.det(PTT), 1e-300))
    return out


@njit(cache=True)
def _swap_score_changes(G, b, first, nonnegative, log_odds, P, own, members, flips):
    """The same by exchanges (terms that leave, terms that enter)."""
    terms = members.shape[0]
    out = np.full((terms, terms), -np.inf)
    for t in range(terms):
        if not members[t]:
            continue
        inside = (own >= first[t]) & (own < first[t + 1])
        T, R = np.nonzero(inside)[0], np.nonzero(~inside)[0]
        if T.shape[0] == 0:
            continue
        PRT = _matrix_block(P, R, T)
        left = _matrix_block(P, R, R) - PRT @ np.linalg.inv(_matrix_block(P, T, T)) @ PRT.T
        out[t] = flips[t] + _with_each(G, b, first, nonnegative, log_odds, left, own[R], members)
    return out


@njit(cache=True)
def _hill_climb_subset(H, c, slab, first, nonnegative, log_odds, start, allowed):
    members = start.copy()
    terms = members.shape[0]
    given = (H, c, slab, first, nonnegative, log_odds)
    now = _subset_score(*given, members)
    for _ in range(4 * terms):
        G, b, own, P = _in_slabs(H, c, slab, first, nonnegative, members)
        flips = _flip_score_changes(G, b, first, nonnegative, log_odds, P, own, members)
        found = False
        for t in np.argsort(-flips):
            if flips[t] < 0.0:
                break
            if not (members[t] or allowed[t]):
                continue
            members[t] = not members[t]
            value = _subset_score(*given, members)  # with the bounds
            if value > now + 1e-9:
                now, found = value, True
                break
            members[t] = not members[t]
        if found:
            continue
        flat = _swap_score_changes(G, b, first, nonnegative, log_odds, P, own, members, flips).ravel()
        for at in np.argsort(-flat)[:EXCHANGE_TRIALS_MAX]:  # exchanges only where no single step helps
            if flat[at] < 0.0:
                break
            t, u = at // terms, at % terms
            if not allowed[u]:
                continue
            members[t], members[u] = False, True
            value = _subset_score(*given, members)
            if value > now + 1e-9:
                now, found = value, True
                break
            members[t], members[u] = True, False
        if not found:
            break
    return members
