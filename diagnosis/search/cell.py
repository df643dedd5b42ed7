"""Cells: parts of the residual that share no parameter, so that each is searched on its own.

Every stage is replayed with its own measured input. What one stage, and but for the pump's sharing one joint, does to
its residual is then independent of all others, and a hypothesis' score is the sum of its cells' scores.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.noise.floor import Whitener
from diagnosis.search.candidates import Candidate
from machine.effects.layout import ParameterSets
from machine.rotations import Array

SCORE_BLOCKS_MIN = 12
BLOCK_ROWS_MAX = 100  # 5 s at 20 Hz
DYNAMIC_STAGES = ("link", "controller", "actuator")  # driven and sampled evenly in time; poses and corners are not


@dataclass(frozen=True, slots=True)
class ResidualRows:
    """What each residual (N,) belongs to: fold (left out together), block (scored together), series, channel.

    `correlation_group`: rows that a model is wrong by alike (one posture), as numbers; None: those of a block.
    """

    fold: NDArray[np.int64]
    block: NDArray[np.int64]
    series: NDArray[np.int64]
    channel: NDArray[np.int64]
    correlation_group: NDArray[np.int64] | None = None

    @property
    def dependent_rows(self) -> NDArray[np.int64]:
        """Which rows do not speak for themselves (N,)."""
        return self.block if self.correlation_group is None else self.correlation_group

    @property
    def row_count(self) -> int:
        """Number of residuals."""
        return len(self.fold)


@dataclass(frozen=True, slots=True)
class Cell:
    """One independent part. `whitened(sets)` gives residuals (sets, N) in units of the floor.

    `scale`: (N,) what one whitened unit is in `unit`; `floor_known`: from repeats.
    `quiet`: the noise's own energy in whitened units, below 1 where the floor was raised to what is believed.
    `baseline_gain_nats`: what each effect gains on baseline recordings, by name; None without a baseline.
    `loose_target_text`: what moved by itself from one look at a posture to the next, in words; empty where nothing did.
    `joined_cells`: the cells that this one joins, rows end to end; empty for a plain one.
    `at_noise`: the same cell by another filter, where the noise was never measured; else None.
    `upstream_parameters`: what is known of the stages before, too, if this one was given it.
    `regressors`: name and value (N,) of what a remainder may go with; `t_s`: (N,).
    """

    stage: str
    joint: int | None
    unit: str
    candidates: tuple[Candidate, ...]
    baseline_parameters: ParameterSets
    whitened: Callable[[ParameterSets], Array]
    rows: ResidualRows
    scale: Array
    quiet: float
    floor_known: bool
    regressors: tuple[tuple[str, Array], ...]
    t_s: Array
    baseline_gain_nats: tuple[tuple[str, float], ...] | None = None
    loose_target_text: str = ""
    joined_cells: tuple["Cell", ...] = ()
    at_noise: Callable[[Whitener], "Cell"] | None = None
    upstream_parameters: ParameterSets | None = None

    def by_part(self, values: Array) -> tuple[tuple["Cell", Array], ...]:
        """The cells that this one joins, a plain one itself, each with its own of values (N, ...)."""
        parts = self.joined_cells or (self,)
        cuts = np.cumsum([part.rows.row_count for part in parts])[:-1]
        return tuple(zip(parts, np.split(values, cuts), strict=True))

    @property
    def label(self) -> str:
        """How it is called in progress lines and tests."""
        return self.stage if self.joint is None else f"{self.stage} {self.joint}"


def blocks_of(series_lengths: list[int]) -> tuple[NDArray[np.int64], int]:
    """Block numbers of rows in series laid end to end, and how many: at most 5 s each, at least 12 in all."""
    total = sum(series_lengths)
    size = max(1, min(BLOCK_ROWS_MAX, total // SCORE_BLOCKS_MIN))
    out, first = [], 0
    for length in series_lengths:
        parts = max(1, round(length / size))
        out.append(first + np.minimum(np.arange(length) * parts // max(length, 1), parts - 1))
        first += parts
    return np.concatenate(out).astype(np.int64) if out else np.zeros(0, np.int64), first


def folds_of(kinds: list[str], lengths: list[int], blocks: NDArray[np.int64]) -> tuple[NDArray[np.int64], bool]:
    """Which rows are left out together: kinds of trajectory; with one kind only, whole pieces; then thirds of one.

    Returns: fold numbers (rows,), and whether folds are of the same kind (a weaker test, to be said).
    """
    names = list(dict.fromkeys(kinds))
    if len(names) > 1:
        numbers = [np.full(length, names.index(kind)) for kind, length in zip(kinds, lengths, strict=True)]
        return np.concatenate(numbers).astype(np.int64), False
    if len(lengths) > 2:
        numbers = [np.full(length, k % 4) for k, length in enumerate(lengths)]
        return np.concatenate(numbers).astype(np.int64), True
    count = int(blocks.max(initial=0)) + 1
    return (blocks * 3 // count).astype(np.int64), True
