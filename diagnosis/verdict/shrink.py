"""How far the chosen effects close the gap on held-out trajectories.

The floor is the noise where the gap stands out from it. A gap of ten times its detection limit may still be a hundredth
of all squares, and no noise is known that well; then the floor is what no effect of the catalogue foretells of one kind
of trajectory after the others: that needs no knowledge of the noise.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri  # scipy.stats takes a second to import

from diagnosis.cells.behind import measurement_of
from diagnosis.families.gain import foretold
from diagnosis.search.cell import Cell
from diagnosis.search.score import Score
from diagnosis.search.search import Search
from machine.rotations import Array

DRAWS = 400
LIMIT_SHARE = 0.05  # of all cases beyond each limit
FLOOR_SHARE = 0.1  # of the floor: how well repeats know it
CLEAR_SHARE = 0.3  # of the noise: a gap three times as large as what the floor may be wrong by
NARROWEST = 0.005  # a share is told to half a percent: what is fitted without a fold is not quite what is fitted to all
TOO_MUCH = 1.1  # of the gap: where surely more than that is closed, the floor is too high for this motion
RIDGES = (0.1, 1.0, 10.0)  # rows' worth of prior: a larger one would make the gap smaller than it is
Floor = Literal["noise", "catalogue"]
Closed = tuple[float | None, float | None, float | None]
UNKNOWN: Closed = (None, None, None)


@dataclass(frozen=True, slots=True)
class Shrink:
    """The gap on held-out trajectories: RMS before, after, floor in `unit`; share closed with 90 % limits.

    `measurement`: static, tracker, ooi, tool or odometry behind the encoders, else empty.
    `floor`: what the share is told above. `floor_by`: the noise, or what no effect of the catalogue foretells.
    """

    stage: str
    joint: int | None
    measurement: str
    unit: str
    before: float
    after: float
    floor: float
    closed_frac: float | None
    low: float | None
    high: float | None
    floor_by: Floor


@dataclass(frozen=True, slots=True)
class Squares:
    """Whitened squares by block (blocks,): before, after, the noise's, what the catalogue foretells of them; `rows`,
    and how many numbers the names were fitted with.
    """

    before: Array
    after: Array
    noise: Array
    foretold: Array
    rows: int
    numbers: int


def squares(found: Search, chosen: Score) -> tuple[Squares, ...]:
    """Of each part of a cell; a plain cell is its own only part."""
    r = found.none.held_out
    explained = r * _catalogue(found, chosen) if chosen.fit.hypothesis else np.zeros(len(r))
    of_rows = np.stack([r**2, chosen.held_out**2, explained], axis=1)
    return tuple(squares_of_part(part, own, chosen.fit.k) for part, own in found.cell.by_part(of_rows))


def squares_of_part(part: Cell, of_rows: Array, numbers: int) -> Squares:
    """A part's squares by block, of rows (N, 3): before, after, predicted by the catalogue."""
    block = part.rows.block
    before, after, foretold_of = (_sums(block, one) for one in of_rows.T)
    noise = np.asarray(part.quiet * np.bincount(block), dtype=float)
    return Squares(before, after, noise, foretold_of, part.rows.count, numbers)


def _catalogue(found: Search, chosen: Score) -> Array:
    """What all effects of the catalogue together say of the residual before, each fold after the others (N,).

    The chosen names count as they were fitted without the fold; all others by their change at one scanned size.
    """
    r = found.none.held_out
    columns = [one.column for one in found.scans if one.column is not None]
    return foretold(np.stack([r - chosen.held_out, *columns], axis=1), r, found.cell.rows, RIDGES)


def shrinks(found: Search, parts: tuple[Squares, ...]) -> tuple[Shrink, ...]:
    """How far the chosen effects close the gap of each part of a cell, in its own unit; limits by resampling blocks."""
    cell = found.cell
    return tuple(shrunk(part, one) for part, one in zip(cell.parts or (cell,), parts, strict=True))


def together(parts: Iterable[Squares]) -> Squares:
    """Parts, or cells, as one."""
    all_of = tuple(parts)
    names = ("before", "after", "noise", "foretold")
    joined = [np.concatenate([getattr(one, name) for one in all_of]) for name in names]
    return Squares(*joined, rows=sum(one.rows for one in all_of), numbers=sum(one.numbers for one in all_of))


def shrunk(cell: Cell, sums: Squares) -> Shrink:
    """One part's share of the gap that is closed, in its own unit."""
    unit_scale = float(np.sqrt(np.mean(cell.scale**2)))
    before, after, floor, closed, floor_by = closing(sums)
    return Shrink(
        cell.stage,
        cell.joint,
        measurement_of(cell),
        cell.unit,
        unit_scale * before,
        unit_scale * after,
        unit_scale * floor,
        *closed,
        floor_by,
    )


def closing(sums: Squares, seed: int = 0) -> tuple[float, float, float, Closed, Floor]:
    """RMS before, after and of the floor that the share is told above [floors]; share closed with its limits; which
    floor that is.

    The noise where the gap stands clear of it; below that the catalogue, if it foretells any; else the noise again.
    """
    by: Floor = "noise"
    floor, closed = _above_noise(sums, seed)
    if float(sums.before.sum() - sums.noise.sum()) <= CLEAR_SHARE * sums.rows:
        beside = sums.before - sums.foretold
        told = _foretold_share(sums, beside, seed)
        if told != UNKNOWN:
            by, floor, closed = "catalogue", beside, told
    before, after, level = (float(np.sqrt(max(0.0, one.sum()) / sums.rows)) for one in (sums.before, sums.after, floor))
    return before, after, level, _told(*closed), by


def _told(closed: float | None, low: float | None, high: float | None) -> Closed:
    """A share as it is told; nothing where it says more of the floor than of the gap."""
    if closed is None or low is None or high is None or low > TOO_MUCH:
        return UNKNOWN
    return closed, min(low, closed - NARROWEST), max(high, closed + NARROWEST)


def by_noise(sums: Squares, seed: int = 0) -> Closed:
    """Share closed above the noise, whatever the catalogue says."""
    return _above_noise(sums, seed)[1]


def _above_noise(sums: Squares, seed: int) -> tuple[Array, Closed]:
    """The noise's sums by block that the share is told above, and the share.

    Where less is left than the noise is said to be, the noise is that at most, and anything down to none: all of the
    gap is closed, but for what is left at the most.
    """
    closed, low, high = closed_share(sums.before, sums.after, sums.noise, sums.rows, seed)
    before, after, noise = (float(one.sum()) for one in (sums.before, sums.after, sums.noise))
    if low is None or after >= (1.0 - FLOOR_SHARE) * noise:
        return sums.noise, (closed, low, high)
    lowered = after / noise * sums.noise
    closed, low, high = closed_share(sums.before, sums.after, lowered, sums.rows, seed)
    return lowered, (closed, min(low, 1.0 - after / before), high) if low is not None else UNKNOWN


def closed_share(before: Array, after: Array, count: Array, rows: int, seed: int) -> Closed:
    """1 - (after - floor) / (before - floor) of squared sums by block, never clipped; None without a gap before.

    Args: count: the floor's own sums by block. rows: residuals in all blocks.
    """
    excess = float(before.sum() - count.sum())
    if excess <= 2.0 * np.sqrt(2.0 * count.sum()) + FLOOR_SHARE * rows:
        return UNKNOWN
    return _share(before, after, count, seed)


def _foretold_share(sums: Squares, floor: Array, seed: int) -> Closed:
    """The same above what the catalogue does not foretell; None where that it foretells any is within the chance of 2
    standard errors over blocks, or where the names close twice as much: it goes by one size of each effect, and that
    of one that limits says little of any other.

    What is foretold is a little less than there is, and holds what the machine's own remainder shares with an effect:
    no limit excludes that all is closed, but for what the fitted numbers may be wrong by.
    """
    gap, closed = sums.foretold, sums.before - sums.after
    if gap.sum() <= 2.0 * np.sqrt(len(gap)) * gap.std(ddof=min(1, len(gap) - 1)) or closed.sum() > 2.0 * gap.sum():
        return UNKNOWN
    share, low, high = _share(sums.before, sums.after, floor, seed)
    if low > TOO_MUCH:
        return UNKNOWN
    wrong = float(chdtri(max(1, sums.numbers), LIMIT_SHARE)) / float(gap.sum())
    return share, min(low, 1.0 - wrong), max(1.0, high)


def _share(before: Array, after: Array, floor: Array, seed: int) -> tuple[float, float, float]:
    closed = 1.0 - float(after.sum() - floor.sum()) / float(before.sum() - floor.sum())
    draws = np.random.default_rng(seed).integers(0, len(before), (DRAWS, len(before)))
    b, a, c = before[draws].sum(axis=1), after[draws].sum(axis=1), floor[draws].sum(axis=1)
    good = b - c > 0.0
    shares = 1.0 - (a[good] - c[good]) / (b[good] - c[good])
    return closed, float(np.quantile(shares, LIMIT_SHARE)), float(np.quantile(shares, 1.0 - LIMIT_SHARE))


def _sums(block: NDArray[np.int64], values: Array) -> Array:
    return np.asarray(np.bincount(block, weights=values), dtype=float)
