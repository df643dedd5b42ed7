"""One diagnosis of a made recording: what it took, and whether it told what was put in."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.diagnosis.cost.made import Size
from benchmarks.diagnosis.diagnose_child import Used, diagnosed_in_a_child


@dataclass(frozen=True, slots=True)
class Timed(Used):
    """What it took, and whether both faults were told and nothing else."""

    joints: int
    exact: bool


def timed(size: Size, recording: Path) -> Timed:
    """Diagnose this recording. Raises: RuntimeError: the command failed."""
    answer = recording / "answer.json"
    used = diagnosed_in_a_child(recording, answer)
    told = json.loads(answer.read_text(encoding="utf-8"))
    named = {(one["name"], one["joint"]) for one in told["hypotheses"][0]["effects"]} if told["hypotheses"] else set()
    exact = told["verdict"] == "effects" and named == {(one.name, one.joint) for one in size.effects}
    return Timed(**asdict(used), joints=size.joints, exact=exact)
