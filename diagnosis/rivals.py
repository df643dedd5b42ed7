"""What simpler methods would have answered, for comparison: never used, only printed beside the answer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from diagnosis.search.fit import evaluated
from diagnosis.search.search import Search
from machine.rotations import Array

if TYPE_CHECKING:
    from diagnosis.verdict.cell_answer import CellAnswer

CLEAR = 2.0  # standard errors: "the interval does not hold neutral"


def rivals(cells: tuple[CellAnswer, ...]) -> dict[str, list[dict[str, Any]]]:
    """Names by "best held-out score wins" and by "fit everything, read the parameters", over all cells."""
    best = [one.key for cell in cells for one in _best(cell.search)]
    everything = [key for cell in cells for key in _everything(cell.search)]
    return {"best_held_out": _told(best), "fit_everything": _told(everything)}


def _told(keys: list[tuple[str, int | None]]) -> list[dict[str, Any]]:
    return [{"name": name, "joint": joint} for name, joint in dict.fromkeys(keys)]


def _best(found: Search):
    return max(found.scored, key=lambda one: one.total).fit.hypothesis


def _everything(found: Search) -> list[tuple[str, int | None]]:
    """One joint Gauss-Newton step over all effects' finite columns; those whose size is two errors from nothing."""
    scans = [one for one in found.scans if one.energy[one.best] > 0.0]
    if not scans:
        return []
    none = found.none.fit.residual
    columns = np.array([evaluated(found.cell, (one.candidate,), one.thetas[[one.best]])[0] - none for one in scans])
    sizes = np.sqrt((columns**2).sum(axis=1))
    A = (columns / sizes[:, None]).T
    amounts, errors = _solved(A, none)
    clear = np.abs(amounts) > CLEAR * errors
    return [one.candidate.key for one, is_clear in zip(scans, clear, strict=True) if is_clear]


def _solved(A: Array, r: Array) -> tuple[Array, Array]:
    """Amounts (k,) and their standard errors, by the residual's own variance as such fits take it."""
    H = A.T @ A
    inverse = np.linalg.pinv(H, rcond=1e-8)
    amounts = -inverse @ (A.T @ r)
    left = r + A @ amounts
    variance = float(left @ left) / max(len(r) - A.shape[1], 1)
    return amounts, np.sqrt(np.maximum(variance * np.diag(inverse), 1e-30))
