"""How far the effects found close the gap on held-out motions, above the noise, with limits by resampling blocks."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.cells.behind import measurement_of
from diagnosis.search.cell import Cell
from diagnosis.whole_model.held_out import HeldOut
from machine.rotations import Array

BOOTSTRAP_DRAWS = 400
LIMIT_TAIL_PROBABILITY = 0.05  # of all cases beyond each limit
NOISE_UNCERTAINTY_FRAC = 0.1  # of the noise: how well repeats determine it
Closed = tuple[float | None, float | None, float | None]
UNKNOWN: Closed = (None, None, None)


@dataclass(frozen=True, slots=True)
class BlockSquares:
    """Whitened squares by block (blocks,): without effects, with them, of the noise; `row_count`: in all blocks."""

    before: Array
    after: Array
    noise: Array
    row_count: int


@dataclass(frozen=True, slots=True)
class GapClosed:
    """The gap of one part on held-out motions: RMS before, after and of the noise in `unit`; share closed with its
    90 % limits. `measurement`: static, tracker, ooi, tool or odometry behind the encoders, else empty.
    """

    stage: str
    joint: int | None
    measurement: str
    unit: str
    rms_without_effects: float
    rms_with_effects: float
    noise_floor: float
    closed_frac_with_limits: Closed


def gaps_closed(held_out: HeldOut) -> list[tuple[GapClosed, BlockSquares]]:
    """Of each part of a cell; a plain cell is its own only part."""
    squares = np.stack([held_out.residual_without_effects**2, held_out.residual_with_effects**2], axis=1)
    out = []
    for part, own in held_out.cell.by_part(squares):
        block = part.rows.block
        before, after = (np.bincount(block, weights=column).astype(float) for column in own.T)
        sums = BlockSquares(
            before, after, np.asarray(part.quiet * np.bincount(block), dtype=float), part.rows.row_count
        )
        out.append((_part_gap_closed(part, sums), sums))
    return out


def gap_closed_of_parts(parts: Iterable[BlockSquares]) -> BlockSquares:
    """Parts as one."""
    some = tuple(parts)
    joined = [np.concatenate([getattr(part, name) for part in some]) for name in ("before", "after", "noise")]
    return BlockSquares(*joined, row_count=sum(part.row_count for part in some))


def _part_gap_closed(part: Cell, sums: BlockSquares) -> GapClosed:
    unit_scale = float(np.sqrt(np.mean(part.scale**2)))
    rms = [unit_scale * x for x in rms_of(sums)]
    return GapClosed(
        part.stage, part.joint, measurement_of(part), part.unit, *rms, closed_frac_with_limits=closed_share(sums)
    )


def rms_of(sums: BlockSquares) -> Sequence[float]:
    """RMS before, after and of the noise, in noise floors."""
    return [float(np.sqrt(x.sum() / sums.row_count)) for x in (sums.before, sums.after, _bounded_noise_squares(sums))]


def excess_squares(squares: float, noise: float, rows: int) -> float:
    """What a sum of squares has beyond the noise's; 0 where chance, or how well repeats know the noise, may be why."""
    excess = squares - noise
    return excess if excess > 2.0 * np.sqrt(2.0 * noise) + NOISE_UNCERTAINTY_FRAC * rows else 0.0


def closed_share(sums: BlockSquares, seed: int = 0) -> Closed:
    """1 - (after - noise) / (before - noise) of the sums of squares, never clipped; None without a gap before."""
    noise = _bounded_noise_squares(sums)
    excess = excess_squares(float(sums.before.sum()), float(noise.sum()), sums.row_count)
    if not excess:
        return UNKNOWN
    closed = 1.0 - float(sums.after.sum() - noise.sum()) / excess
    draws = np.random.default_rng(seed).integers(0, len(noise), (BOOTSTRAP_DRAWS, len(noise)))
    b, a, n = sums.before[draws].sum(axis=1), sums.after[draws].sum(axis=1), noise[draws].sum(axis=1)
    good = b - n > 0.0
    shares = 1.0 - (a[good] - n[good]) / (b[good] - n[good])
    return (
        closed,
        float(np.quantile(shares, LIMIT_TAIL_PROBABILITY)),
        float(np.quantile(shares, 1.0 - LIMIT_TAIL_PROBABILITY)),
    )


def _bounded_noise_squares(sums: BlockSquares) -> Array:
    """The noise's squares by block (blocks,): where less is left than the noise is said to be, what is left."""
    return sums.noise * min(1.0, float(sums.after.sum()) / max(float(sums.noise.sum()), 1e-300))
