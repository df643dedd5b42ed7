"""One case: diagnose, do what is proposed, diagnose both recordings together."""

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.diagnosis.answered import answered
from benchmarks.diagnosis.experiments.arm import Truth
from benchmarks.diagnosis.experiments.cases import NAMES, Key, draw
from benchmarks.diagnosis.experiments.recorded import executed
from diagnosis.experiments.described import experiment_of
from diagnosis.reading.together import join_recordings

SURE = 0.95
EXECUTED_STREAM = 77


@dataclass(frozen=True)
class Outcome:
    """One case, after the first recording and after both.

    `apart_*`: probability that it is the true effect and neither the other one of the pair nor any that a proposed
    experiment was to tell apart, whatever else may be at work; `p_*`: of the true effect and nothing else.
    """

    pair: str
    seed: int
    truth: str
    joint: int | None
    size: float
    verdict_first: str
    apart_first: float
    p_first: float
    what: str | None
    separates: list[str]
    expected_nats: float | None
    minutes: float | None
    verdict_both: str
    apart_both: float
    p_both: float
    best_both: list[str]

    @property
    def ambiguous(self) -> bool:
        """Whether there was anything to separate."""
        return self.apart_first <= SURE

    @property
    def separated(self) -> bool:
        """Whether both recordings together leave no doubt which of them it is."""
        return self.apart_both > SURE

    @property
    def alone(self) -> bool:
        """Whether they leave no doubt that nothing else is at work, either."""
        return self.p_both > SURE

    def to_line(self) -> str:
        """For a JSON-lines file."""
        return json.dumps(asdict(self))


def run_case(pair: str, seed: int) -> Outcome:
    """One draw of a pair, through to the second diagnosis. The proposal passes through JSON, as a machine gets it."""
    case = draw(pair, seed)
    truth = case.rig.truth
    first = answered(case.first)
    proposal = json.loads(json.dumps(first["next_experiment"]))
    proposed = proposal.get("execute") is not None
    separates = {(one["name"], one["joint"]) for one in proposal["separates"]} if proposed else set()
    rivals = {*NAMES[pair], *separates} - {(truth.name, truth.joint)}
    both, second = first, None
    if proposed:
        rng = np.random.default_rng([seed, EXECUTED_STREAM])
        second = executed(case.rig, experiment_of(proposal["execute"]), rng)
        both = answered(join_recordings([case.first, second]))
    return Outcome(
        pair,
        seed,
        truth.name,
        truth.joint,
        truth.size,
        first["verdict"],
        apart(first, truth, rivals),
        alone(first, truth),
        proposal["what"],
        [one["name"] for one in proposal["separates"]],
        proposal["expected_nats"],
        proposal["minutes"],
        both["verdict"],
        apart(both, truth, rivals),
        alone(both, truth),
        [
            f"{effect['name']} {effect['joint'] or ''}".strip()
            for effect in both["budget"]["effects"]
            if effect["status"] == "confirmed"
        ],
    )


def apart(result: dict[str, Any], truth: Truth, rivals: set[Key]) -> float:
    """Probability of the true effect without any of its rivals."""
    stated = _stated(result)
    without = [1.0 - p for key, p in stated.items() if key in rivals]
    return float(np.prod([stated.get((truth.name, truth.joint), 0.0), *without]))


def alone(result: dict[str, Any], truth: Truth) -> float:
    """Probability of the true effect and nothing else."""
    return apart(result, truth, set(_stated(result)) - {(truth.name, truth.joint)})


def _stated(result: dict[str, Any]) -> dict[Key, float]:
    return {(row["name"], row["joint"]): float(row["probability"]) for row in result["budget"]["effects"]}
