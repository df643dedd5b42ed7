"""Many cases in a few numbers: means beside the paper's, shares inside tolerance with intervals, honest ellipses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from benchmarks.reproduce.cases import Case
from benchmarks.reproduce.true_error import StepErrors, Three


@dataclass(frozen=True, slots=True)
class MeanErrors:
    """Mean absolute errors after one step over n machines, (x, y, z) [mm], and the sd of depth in camera axes."""

    name: str
    n: int
    camera_image_mm: Three
    camera_true_mm: Three
    goal_image_mm: Three
    goal_true_mm: Three
    rotation_true_deg: float
    depth_sd_mm: float


def mean_errors(cases: Sequence[Case], name: str) -> MeanErrors:
    """Mean absolute errors of the step of that name over the cases that have it."""
    steps = [step for case in cases for step in case.steps if step.name == name]

    def mean(attribute: str) -> Three:
        values = np.abs([getattr(step, attribute) for step in steps]).reshape(-1, 3)
        x, y, z = values.mean(axis=0) if len(values) else (np.nan,) * 3
        return float(x), float(y), float(z)

    depth = [step.camera_image_mm[2] for step in steps]
    return MeanErrors(
        name=name,
        n=len(steps),
        camera_image_mm=mean("camera_image_mm"),
        camera_true_mm=mean("camera_true_mm"),
        goal_image_mm=mean("goal_image_mm"),
        goal_true_mm=mean("goal_true_mm"),
        rotation_true_deg=float(np.mean([step.rotation_true_deg for step in steps])) if steps else float("nan"),
        depth_sd_mm=float(np.std(depth, ddof=1)) if len(depth) > 1 else float("nan"),
    )


@dataclass(frozen=True, slots=True)
class Share:
    """k of n with its 95 % interval (Clopper and Pearson)."""

    k: int
    n: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """k / n."""
        return self.k / self.n if self.n else float("nan")


def share(flags: Sequence[bool]) -> Share:
    """Share of the true ones."""
    k, n = int(sum(flags)), len(flags)
    if n == 0:
        return Share(0, 0, 0.0, 1.0)
    interval = binomtest(k, n).proportion_ci(0.95)
    return Share(k, n, float(interval.low), float(interval.high))


def after_moves(case: Case, moves: int) -> StepErrors | None:
    """The last step within that many moves: a job that ended earlier stays where it is. None without any move."""
    steps = [step for step in case.steps if step.name.startswith("move")][:moves]
    return steps[-1] if steps else None


def inside(case: Case, moves: int, limit_mm: float = 5.0) -> bool:
    """Whether true |x| and |y| are inside after that many moves; refusals and failures are not."""
    step = after_moves(case, moves)
    return step is not None and max(abs(value) for value in step.goal_true_mm[:2]) <= limit_mm


def held(cases: Sequence[Case], sigmas: float = 1.96) -> Share:
    """Share of true per-axis errors after the first move that their prediction holds."""
    flags: list[bool] = []
    for case in cases:
        step = after_moves(case, 1)
        if step is not None and step.predicted_sigma_mm is not None:
            flags += [
                abs(error) <= sigmas * sigma
                for error, sigma in zip(step.goal_true_mm, step.predicted_sigma_mm, strict=True)
            ]
    return share(flags)
