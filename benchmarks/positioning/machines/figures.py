"""Many machines in a few numbers: success, accuracy, honesty of the predictions, times."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.positioning.machines.machine_run import INSIDE_MM, MachineRun, MoveErrors
from benchmarks.reproduce.summary import Share, share
from machine.rotations import Array

SIGMA_95 = 1.959964
CHI2_95_OF_3 = 7.814728
DIGITS = str.maketrans("0123456789", "#" * 10)


@dataclass(frozen=True, slots=True)
class Accuracy:
    """True errors at rest within so many moves: mean |x|, |y|, |z|, median 3-D, 95 % of |z| [mm] and rotation [deg]."""

    moves: int
    inside: Share
    mean_mm: Array
    median_3d_mm: float
    p95_z_mm: float
    p95_deg: float


@dataclass(frozen=True, slots=True)
class Honesty:
    """What predictions made before one move hold of its true errors: each axis, all axes, the 3-D ellipsoid.

    nees: mean of e^T C^-1 e / 3, 1 if honest. ratio: rms of error over sigma, per axis.
    """

    n: int
    axes: tuple[Share, Share, Share]
    pooled: Share
    ellipsoid: Share
    nees: float
    ratio: Array


def drawn(runs: Sequence[MachineRun]) -> list[MachineRun]:
    """Those for which there was a scene at all."""
    return [run for run in runs if run.state != "undrawn"]


def two_made(runs: Sequence[MachineRun]) -> Accuracy | None:
    """True errors of the machines of which two moves are on file, needed or not; None if there are none."""
    steps = [step for run in drawn(runs) if run.state == "done" and (step := run.after_two_made()) is not None]
    if not steps:
        return None
    return _accuracy(2, share([max(map(abs, step.true_mm[:2])) <= INSIDE_MM for step in steps]), steps)


def accuracy(runs: Sequence[MachineRun], moves: int) -> Accuracy:
    """Over all drawn machines; refused ones count as failures, their errors are left out."""
    steps = [step for run in drawn(runs) if run.state == "done" and (step := run.after(moves)) is not None]
    return _accuracy(moves, share([run.inside(moves) for run in drawn(runs)]), steps)


def _accuracy(moves: int, inside: Share, steps: Sequence[MoveErrors]) -> Accuracy:
    errors = np.array([step.true_mm for step in steps]).reshape(-1, 3)
    turns = np.array([step.true_deg for step in steps])
    return Accuracy(
        moves=moves,
        inside=inside,
        mean_mm=np.abs(errors).mean(axis=0),
        median_3d_mm=float(np.median(np.linalg.norm(errors, axis=1))),
        p95_z_mm=float(np.percentile(np.abs(errors[:, 2]), 95.0)),
        p95_deg=float(np.percentile(turns, 95.0)),
    )


def honesty(runs: Sequence[MachineRun], number: int = 1) -> Honesty:
    """Of the move of that number, every machine that made it, refused later or not."""
    steps = [run.moves[number - 1] for run in runs if len(run.moves) >= number]
    predicted = [step for step in steps if step.covariance_mm2 is not None]
    ratios = np.array([np.divide(step.true_mm, step.sigma_mm) for step in predicted]).reshape(-1, 3)
    squares = [_square(step) for step in predicted]
    held = np.abs(ratios) <= SIGMA_95
    x, y, z = (share(column.tolist()) for column in held.T)
    return Honesty(
        n=len(predicted),
        axes=(x, y, z),
        pooled=share(held.ravel().tolist()),
        ellipsoid=share([square <= CHI2_95_OF_3 for square in squares]),
        nees=float(np.mean(squares)) / 3.0,
        ratio=np.sqrt(np.mean(ratios**2, axis=0)),
    )


def _square(step: MoveErrors) -> float:
    error = np.array(step.true_mm)
    return float(error @ np.linalg.solve(np.array(step.covariance_mm2), error))


def refusals(runs: Sequence[MachineRun]) -> list[tuple[str, list[int]]]:
    """Reasons, their numbers taken out, with the seeds; the most frequent first."""
    by_reason: dict[str, list[int]] = {}
    for run in drawn(runs):
        if run.state != "done":
            by_reason.setdefault(run.reason.translate(DIGITS), []).append(run.seed)
    order = Counter({reason: len(seeds) for reason, seeds in by_reason.items()})
    return [(reason, by_reason[reason]) for reason, _ in order.most_common()]


def disobedient(runs: Sequence[MachineRun]) -> list[int]:
    """Seeds that moved, but looked last or drove their calibration path nearer than the facts allow."""
    return [run.seed for run in drawn(runs) if run.moves and not run.obeys]


def seconds(runs: Sequence[MachineRun]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Median and 95 % of the seconds from the first look to rest on target: with, and without, a calibration."""
    done = [run for run in runs if run.state == "done"]
    return _middle_and_95([run.rest_s for run in done]), _middle_and_95([run.again_rest_s for run in done])


def _middle_and_95(values: Sequence[float]) -> tuple[float, float]:
    usable = np.array(values)[np.isfinite(values)] if values else np.zeros(0)
    if not len(usable):
        return float("nan"), float("nan")
    middle, high = np.percentile(usable, [50.0, 95.0])
    return float(middle), float(high)


def worst(runs: Sequence[MachineRun], moves: int = 1, n: int = 10) -> list[tuple[int, MoveErrors]]:
    """Seeds with the largest true |x| or |y| after so many moves."""
    steps = [(run.seed, step) for run in drawn(runs) if (step := run.after(moves)) is not None]
    return sorted(steps, key=lambda one: -max(abs(one[1].true_mm[0]), abs(one[1].true_mm[1])))[:n]
