"""Experiments as a machine takes them: a reference by its knots, or postures to look from; and back again."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.errors import DiagnosisError
from diagnosis.experiments.library import LOOK_CYCLE_DURATION_S, SAMPLE_PERIOD_S, Experiment, Motion, Postures
from diagnosis.sliding import unit_of
from machine.rotations import Array

SAMPLES_PER_KNOT = 10  # a knot every 0.1 s
ANGLE_DECIMALS = 6
JOINT_MOTION_MIN_RAD = 1e-6


def describe_motions(experiment: Experiment, sliding: tuple[bool, ...] = ()) -> dict[str, Any]:
    """For the answer's JSON. Motions: joints that move, and their knots; the others stay where they start.

    `t_knot_s`: between two knots; the course between them is the cubic spline with zero speed at both ends.
    `joint_units`: of every joint's numbers in `start_rad` and `q_rad`, where some joint slides: these are in m.
    """
    description = _experiment_json(experiment)
    units = [unit_of("rad", sliding, j) for j in range(len(sliding))]
    return {**description, "joint_units": units} if any(sliding) else description


def _experiment_json(experiment: Experiment) -> dict[str, Any]:
    if isinstance(experiment, Postures):
        postures = np.round(experiment.q, ANGLE_DECIMALS).tolist()
        return {
            "kind": "looks",
            "name": experiment.name,
            "q_rad": postures,
            "look_s": LOOK_CYCLE_DURATION_S,
            "from_below": True,
        }
    knots = experiment.q[_knot_rows(len(experiment.q))]
    moving = np.nonzero(np.abs(knots - knots[0]).max(axis=0) > JOINT_MOTION_MIN_RAD)[0]
    return {
        "kind": "motion",
        "name": experiment.name,
        "segment_kind": experiment.segment_kind,
        "start_rad": np.round(knots[0], ANGLE_DECIMALS).tolist(),
        "t_knot_s": SAMPLES_PER_KNOT * SAMPLE_PERIOD_S,
        "joints": (moving + 1).tolist(),
        "q_rad": np.round(knots[:, moving], ANGLE_DECIMALS).tolist(),
    }


def _knot_rows(rows: int) -> NDArray[np.int64]:
    return np.arange(0, rows, SAMPLES_PER_KNOT, dtype=np.int64)


def experiment_of(description: dict[str, Any]) -> Experiment:
    """An experiment back from its description.

    Raises: DiagnosisError: not a description of this version.
    """
    try:
        if description["kind"] == "looks":
            return Postures(str(description["name"]), np.array(description["q_rad"], dtype=float))
        start = np.array(description["start_rad"], dtype=float)
        knots = np.tile(start, (len(description["q_rad"]), 1))
        knots[:, np.array(description["joints"], dtype=int) - 1] = np.array(description["q_rad"], dtype=float)
        q = spline_course(knots, round(float(description["t_knot_s"]) / SAMPLE_PERIOD_S))
        return Motion(str(description["name"]), description["segment_kind"], q)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise DiagnosisError(f"not an experiment's description: {error!r}") from error


def spline_course(knots: Array, rows: int) -> Array:
    """A course through knots (k, n), `rows` samples each, by the cubic spline at rest at both ends."""
    k = len(knots)
    A = np.diag(np.full(k, 4.0)) + np.diag(np.ones(k - 1), 1) + np.diag(np.ones(k - 1), -1)
    rhs = np.zeros_like(knots)
    rhs[1:-1] = 3.0 * (knots[2:] - knots[:-2])
    A[0], A[-1] = 0.0, 0.0
    A[0, 0] = A[-1, -1] = 1.0
    slopes = np.linalg.solve(A, rhs)
    u = (np.arange(rows) / rows)[None, :, None]
    a, b, da, db = knots[:-1, None], knots[1:, None], slopes[:-1, None], slopes[1:, None]
    course = a * (2 * u**3 - 3 * u**2 + 1) + da * (u**3 - 2 * u**2 + u) + b * (3 * u**2 - 2 * u**3) + db * (u**3 - u**2)
    return np.concatenate([course.reshape(-1, knots.shape[1]), knots[-1:]])
