"""One case: diagnose, do what is proposed, diagnose both recordings together."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.answer import answer
from diagnosis.diagnose import diagnose
from diagnosis.experiments.described import experiment_of
from diagnosis.reading import examine
from diagnosis.together import together
from longreach.bench_experiments.arm import Truth
from longreach.bench_experiments.cases import draw
from longreach.bench_experiments.recorded import executed
from recording.content import Recording

SURE = 0.95
EXECUTED_STREAM = 77


@dataclass(frozen=True)
class Outcome:
    """One case. `p_first`, `p_both`: probability of the true effect alone; `ambiguous`: the first was not sure."""

    pair: str
    seed: int
    truth: str
    joint: int | None
    size: float
    verdict_first: str
    p_first: float
    what: str | None
    separates: list[str]
    expected_nats: float | None
    minutes: float | None
    verdict_both: str
    p_both: float
    best_both: list[str]

    @property
    def ambiguous(self) -> bool:
        """Whether there was anything to separate."""
        return self.p_first <= SURE

    @property
    def separated(self) -> bool:
        """Whether both recordings together leave no doubt."""
        return self.p_both > SURE

    def to_line(self) -> str:
        """For a JSON-lines file."""
        return json.dumps(asdict(self))


def run_case(pair: str, seed: int) -> Outcome:
    """One draw of a pair, through to the second diagnosis. The proposal passes through JSON, as a machine gets it."""
    case = draw(pair, seed)
    truth = case.rig.truth
    first = _answered(case.first)
    proposal = json.loads(json.dumps(first["next_experiment"]))
    both, second = first, None
    if proposal.get("execute") is not None:
        rng = np.random.default_rng([seed, EXECUTED_STREAM])
        second = executed(case.rig, experiment_of(proposal["execute"]), rng)
        both = _answered(together([case.first, second]))
    return Outcome(
        pair,
        seed,
        truth.name,
        truth.joint,
        truth.size,
        first["verdict"],
        _probability(first, truth),
        proposal["what"],
        [one["name"] for one in proposal["separates"]],
        proposal["expected_nats"],
        proposal["minutes"],
        both["verdict"],
        _probability(both, truth),
        [
            f"{one['name']} {one['joint'] or ''}".strip()
            for one in (both["hypotheses"] or [{"effects": []}])[0]["effects"]
        ],
    )


def _answered(recording: Recording) -> dict[str, Any]:
    whole = examine(recording, Path("bench"))
    if not whole.usable:
        raise RuntimeError("; ".join(str(one) for one in whole.findings))
    return answer(diagnose(whole))


def _probability(result: dict[str, Any], truth: Truth) -> float:
    """Probability of the true effect and nothing else, among all that the catalogue explains.

    Why among those: an experiment is to tell one name from its rivals. What may be at work beside them, outside the
    catalogue or too small to be seen, is as likely after it as before.
    """
    wanted = [(truth.name, truth.joint)]
    found = sum(
        one["probability"]
        for one in result["hypotheses"]
        if [(effect["name"], effect["joint"]) for effect in one["effects"]] == wanted
    )
    return float(found / (1.0 - result["outside_probability"] - result["unseen_probability"]))
