"""The next experiment: what of the library best separates the hypotheses that a diagnosis leaves open."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.experiments.described import describe_motions
from diagnosis.experiments.library import Experiment, Motion, library_motions
from diagnosis.experiments.postures import candidate_postures, gravity_extremes, is_object_visible, look_posture_choices
from diagnosis.experiments.prediction import Hypothesis, residuals_with_postures, rows_of_motion, sets_of
from diagnosis.experiments.separation import separation_nats
from diagnosis.log.nominal import Nominal
from diagnosis.reading.read import Read
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.cell import Cell
from diagnosis.whole_model.evidence import DISTINCT_SQUARED_DISTANCE_MIN
from machine.effects.layout import ParameterSets
from machine.rotations import Array

Key = tuple[str, int | None]  # an effect and its joint
SEPARATION_SATURATION_NATS = 30.0  # beyond it two hypotheses are distinguished; more is not better, sooner is
POSTURE_POOL_SEED = 5
SEPARATION_MIN_NATS = (
    0.5 * DISTINCT_SQUARED_DISTANCE_MIN
)  # of a pair: an experiment that gives less of each of them separates nothing
PROPOSAL_CELLS_MAX = 3  # asked about
DURATION_COST_NATS_PER_MIN = 0.01  # nats a minute: of equals the shorter one
LINK_SIDE_SEPARABLE_EFFECTS = ("encoder_scale", "encoder_eccentricity")
SIGNAL_ADVICE_BY_STAGE = {
    "actuator": "a measurement behind the encoder (a tracked point, a marker)",
    "structure": "points on other links, or a load of known mass",
    "camera": "the second eye, or points from a tracker",
}


@dataclass(frozen=True, slots=True)
class Pair:
    """Two sets of effects of one part, how much their difference matters, and the effects that differ.

    `variance_inflation`: by how much the part's scores are to be divided.
    """

    cell: Cell
    variance_inflation: float
    best_hypothesis: Hypothesis
    rival_hypothesis: Hypothesis
    importance_weight: float
    differing_effects: tuple[Key | None, Key | None]


def experiment_for(whole: Read, cells: list[list[Pair]], settled: bool) -> dict[str, Any]:
    """What to drive or look at, how long, which pair it separates, the nats it should give; how to execute it.

    Of the parts with open pairs (`cells`, the weightiest first) the first that an experiment can do something about.
    `settled`: whether the answer is sure without them.
    """
    nominal = whole.nominal_machine
    if not cells or nominal is None:
        why = "nothing is left to separate" if settled else "no pair of names is live"
        return {"what": None, "minutes": None, "separates": [], "expected_nats": None, "why": why}
    nothing: list[dict[str, Any]] = []
    for pairs in cells[:PROPOSAL_CELLS_MAX]:
        proposal = _best_experiment(whole, nominal, pairs)
        if proposal["what"] is not None:
            return proposal
        nothing.append(proposal)
    return nothing[0]


def _best_experiment(whole: Read, nominal: Nominal, pairs: list[Pair]) -> dict[str, Any]:
    """The experiment that best separates one cell's open pairs."""
    library = _possible_experiments(whole, nominal, pairs)
    table = {experiment.name: [_expected_nats(whole, pair, experiment) for pair in pairs] for experiment in library}
    able = [experiment for experiment in library if max(table[experiment.name]) >= SEPARATION_MIN_NATS]
    best = max(able, key=lambda experiment: _experiment_value(pairs, table[experiment.name], experiment), default=None)
    if best is None:
        return _missing_signal_advice(pairs[0], table)
    first = next(k for k, nats in enumerate(table[best.name]) if nats >= SEPARATION_MIN_NATS)  # the weightiest of them
    return {
        "what": best.name,
        "minutes": round(best.duration_min, 2),
        "separates": _pair_members(pairs[first]),
        "expected_nats": _round_significant(table[best.name][first]),
        "alternatives": {name: _round_significant(row[first]) for name, row in table.items()},
        "why": "the recording does not distinguish "
        + " from ".join(map(_hypothesis_name, pairs[first].differing_effects)),
        "pairs": [
            {"separates": _pair_members(pair), "expected_nats": _round_significant(nats)}
            for pair, nats in zip(pairs, table[best.name], strict=True)
        ],
        "execute": describe_motions(best, nominal.joint_slides),
    }


def _possible_experiments(whole: Read, nominal: Nominal, pairs: list[Pair]) -> tuple[Experiment, ...]:
    """Everything that this machine can do about these pairs."""
    cell = pairs[0].cell
    centre = middle_posture(whole)
    near = candidate_postures(nominal, centre, np.random.default_rng(POSTURE_POOL_SEED))
    if isinstance(cell.whitened, Replay):
        joints = _joints_of_pairs(pairs, nominal.n)
        return library_motions(
            nominal, centre, joints, gravity_extremes(nominal, cell.baseline_parameters, near, joints)
        )
    parts = [part.whitened for part in cell.joined_cells or (cell,)]
    seen = next(
        (residual for residual in parts if isinstance(residual, CornerResidual) and residual.marker_carrier == "ooi"),
        None,
    )
    if seen is None:
        return look_posture_choices(nominal, cell.baseline_parameters, near, None)
    kept = near[is_object_visible(nominal, cell.baseline_parameters, near, seen.T_base_ooi)]
    return look_posture_choices(nominal, cell.baseline_parameters, kept, seen.T_base_ooi)


def middle_posture(whole: Read) -> Array:
    """The posture (n,) around which the recording was made."""
    nominal = whole.nominal_machine
    recorded = [stretch.enc for stretch in whole.stretches if stretch.enc is not None]
    static = whole.tables.static if whole.tables is not None else None
    if not recorded and static is not None and static.q is not None:
        recorded = [static.q]
    n = nominal.n if nominal is not None else 0
    return np.nan_to_num(np.nanmedian(np.concatenate(recorded), axis=0)) if recorded else np.zeros(n)


def _joints_of_pairs(pairs: list[Pair], n: int) -> tuple[int, ...]:
    """The joints (0-based) that the open names are about; all where one is the machine's own."""
    names = [name for pair in pairs for name in pair.differing_effects if name is not None]
    if any(joint is None for _, joint in names):
        return tuple(range(n))
    return tuple(sorted({joint - 1 for _, joint in names if joint is not None}))


def _expected_nats(whole: Read, pair: Pair, experiment: Experiment) -> float:
    """The least expected nats of the pair, whichever of the two is true."""
    cell = pair.cell
    both = []
    for mine, other in ((pair.best_hypothesis, pair.rival_hypothesis), (pair.rival_hypothesis, pair.best_hypothesis)):
        truth: ParameterSets = sets_of(cell, mine)
        if isinstance(experiment, Motion):
            rows, holds = rows_of_motion(whole, cell, experiment, truth), True
        else:
            rows, holds = residuals_with_postures(whole, cell, experiment, truth), False
        if rows is None:
            return 0.0
        both.append(separation_nats(pair.cell, pair.variance_inflation, rows, truth, other, holds))
    return min(both)


def _experiment_value(pairs: list[Pair], nats: list[float], experiment: Experiment) -> float:
    """Nats that count, weighed over the pairs, less what the machine's time costs."""
    gained = sum(
        pair.importance_weight * min(nats_of, SEPARATION_SATURATION_NATS)
        for pair, nats_of in zip(pairs, nats, strict=True)
    )
    return gained / sum(pair.importance_weight for pair in pairs) - DURATION_COST_NATS_PER_MIN * experiment.duration_min


def _missing_signal_advice(pair: Pair, table: dict[str, list[float]]) -> dict[str, Any]:
    """No experiment of the library separates the pair: which signal would."""
    cell = pair.cell
    signal = SIGNAL_ADVICE_BY_STAGE.get(cell.stage, SIGNAL_ADVICE_BY_STAGE["structure"])
    if cell.joint is None and cell.stage == "actuator":
        signal = "log the received reference (q_ref) and the valve command (u)"
    behind = cell.stage == "actuator" and any(
        name is not None and name[0] in LINK_SIDE_SEPARABLE_EFFECTS for name in pair.differing_effects
    )
    names = f"{_hypothesis_name(pair.differing_effects[0])} from {_hypothesis_name(pair.differing_effects[1])}"
    return {
        "what": "look at a marker, or track a point, from ten postures" if behind else None,
        "minutes": 5.0 if behind else None,
        "separates": _pair_members(pair),
        "expected_nats": None,
        "alternatives": {name: _round_significant(row[0]) for name, row in table.items()},
        "why": f"no motion distinguishes {names} by what was logged; needed: {signal}",
        "signal": signal,
    }


def _pair_members(pair: Pair) -> list[dict[str, Any]]:
    return [{"name": name[0], "joint": name[1]} for name in pair.differing_effects if name is not None]


def _hypothesis_name(name: Key | None) -> str:
    return "a sound machine" if name is None else name[0]


def _round_significant(nats: float) -> float:
    return float(f"{nats:.3g}")
