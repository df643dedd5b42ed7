"""Cells: parts of the residual that share no parameter, so that each is searched on its own.

Every stage is replayed with its own measured input. What one stage, and but for the pump's sharing one joint, does to
its residual is then independent of all others, and a hypothesis' score is the sum of its cells' scores.
"""

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from diagnosis.noise.floor import Whitener
from diagnosis.search.candidates import SWINGS, Candidate
from diagnosis.search.margin import margin_of
from machine.effects.kernel import KNOWN_HZ
from machine.effects.layout import ParameterSets
from machine.remainder import usual_name
from machine.rotations import Array

BLOCKS_MIN = 12
FORM_SHARE = 0.002
BLOCK_ROWS_MAX = 100  # 5 s at 20 Hz
EXCEEDED_TIMES = 1.5  # the most that some recordings showed is exceeded by one more in every dozen
COMMON_MIN = 3
SLOW = 0.9  # of the frequency of a joint's known swing
DRIVEN_STAGES = ("link", "controller", "actuator")  # driven and sampled evenly in time; poses and corners are not


@dataclass(frozen=True, slots=True)
class Rows:
    """What each residual (N,) belongs to: fold (left out together), block (scored together), series, channel.

    `whole`: blocks before one of them was cut into pieces (`search/rare.py`); None where none was. `alike`: rows that a
    model is wrong by alike (one posture), as numbers; None: those of a block.
    """

    fold: NDArray[np.int64]
    block: NDArray[np.int64]
    series: NDArray[np.int64]
    channel: NDArray[np.int64]
    whole: NDArray[np.int64] | None = None
    alike: NDArray[np.int64] | None = None

    @property
    def together(self) -> NDArray[np.int64]:
        """Which rows do not speak for themselves (N,)."""
        return self.block if self.alike is None else self.alike

    @property
    def count(self) -> int:
        """Number of residuals."""
        return len(self.fold)


@dataclass(frozen=True, slots=True)
class Cell:
    """One independent part. `whitened(sets)` gives residuals (sets, N) in units of the floor.

    `scale`: (N,) what one whitened unit is in `unit`; `base`: the baseline's parameters; `floor_known`: from repeats.
    `floor_squares`: how many squared differences of repeats the floor was found from; 0 where they are many.
    `quiet`: the noise's own energy in whitened units, below 1 where the floor was raised to what is believed.
    `coarse`: its input between logged rows is a guess; `least_nats`: what that guess may be wrong by, at least.
    `form_share`: of all that is gained, what a further effect has to gain: no model is right to better than this.
    `spread_least`: scores are divided by it at least (a baseline's remainder is no white noise).
    `usual`: tests that fire on the undisturbed machine, and their sizes there; `left_share`: of the floor, in squares,
    what the machine file's baseline leaves of the model's form. `usual_names`: among them what names gain there [nats].
    `unlike`: joints that moved unlike any undisturbed recording, by their command or by what the form says of them.
    `stuck`: joints that were told to stick: they moved unlike as well, and knock at the others.
    `restless`: what moved by itself from one look at a posture to the next, in words; empty where nothing did.
    `parts`: the cells that this one joins, rows end to end; empty for a plain one.
    `at_noise`: the same cell by another filter, where the noise was never measured; else None.
    `course`: what is known of the stages before, too, if this one was given it.
    `regressors`: name and value (N,) of what a remainder may go with; `t_s`: (N,).
    """

    stage: str
    joint: int | None
    unit: str
    candidates: tuple[Candidate, ...]
    base: ParameterSets
    whitened: Callable[[ParameterSets], Array]
    rows: Rows
    scale: Array
    quiet: float
    floor_known: bool
    same_kind: bool
    regressors: tuple[tuple[str, Array], ...]
    t_s: Array
    floor_squares: int = 0
    coarse: bool = False
    least_nats: float = 0.0
    spread_least: float = 1.0
    form_share: float = FORM_SHARE
    usual: tuple[tuple[str, float], ...] = ()
    left_share: float = 0.0
    usual_names: tuple[tuple[str, float], ...] = ()
    unlike: tuple[int, ...] = ()
    stuck: tuple[int, ...] = ()
    restless: str = ""
    parts: tuple["Cell", ...] = ()
    at_noise: Callable[[Whitener], "Cell"] | None = None
    course: ParameterSets | None = None

    @property
    def moved_unlike(self) -> tuple[int, ...]:
        """Joints that moved unlike any undisturbed recording, by whatever cause."""
        return tuple(sorted({*self.unlike, *self.stuck}))

    @property
    def knocked(self) -> bool:
        """An actuator beside a joint that sticks, whose jumps move what it holds: what it leaves says nothing."""
        return self.stage == "actuator" and bool(self.stuck) and self.joint not in (None, *self.stuck)

    @property
    def usual_known(self) -> bool:
        """Whether a baseline says of any part what it shows on the undisturbed machine."""
        return any(part.usual for part in self.parts or (self,))

    @property
    def known_well(self) -> bool:
        """Whether a baseline says what this cell shows on the undisturbed machine, all of its parts."""
        return all(part.usual for part in self.parts or (self,))

    @property
    def noise_guessed(self) -> bool:
        """Whether it drives a joint and nobody measured its noise: nothing was repeated, and no baseline knows it."""
        return self.stage in DRIVEN_STAGES and not self.floor_known and not self.known_well

    def usual_nats(self, effect: Candidate, numbers: Array) -> float:
        """What an effect of these numbers (slots,) may gain on the undisturbed machine, beyond the margin that every
        name is asked for [nats, not divided].

        Where several names are known to gain more than chance there, any other one may gain as much as the middle one
        of them on the next day.
        """
        known = dict(self.usual_names)
        common = median(known.values()) if len(known) >= COMMON_MIN else 0.0
        most = max(known.get(usual_name(self.usual_as(effect, numbers)), 0.0), common)
        return max(0.0, EXCEEDED_TIMES * most - margin_of(effect))

    def usual_as(self, effect: Candidate, numbers: Array) -> str:
        """The name by which a baseline knows it: a swing slower than its joint's own is not what booms do every day."""
        if effect.name not in SWINGS or effect.joint is None:
            return effect.name
        shape = {slot.parameter: x for slot, x in (*zip(effect.slots, numbers, strict=True), *effect.fixed)}
        own_hz = self.base.joint[0, effect.joint - 1, KNOWN_HZ]
        return f"slow {effect.name}" if shape["frequency_hz"] < SLOW * own_hz else effect.name

    def by_part(self, values: Array) -> tuple[tuple["Cell", Array], ...]:
        """The cells that this one joins, a plain one itself, each with its own of values (N, ...)."""
        parts = self.parts or (self,)
        cuts = np.cumsum([part.rows.count for part in parts])[:-1]
        return tuple(zip(parts, np.split(values, cuts), strict=True))

    @property
    def label(self) -> str:
        """How it is called in progress lines and tests."""
        return self.stage if self.joint is None else f"{self.stage} {self.joint}"


def blocks_of(series_lengths: list[int]) -> tuple[NDArray[np.int64], int]:
    """Block numbers of rows in series laid end to end, and how many: at most 5 s each, at least 12 in all."""
    total = sum(series_lengths)
    size = max(1, min(BLOCK_ROWS_MAX, total // BLOCKS_MIN))
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
