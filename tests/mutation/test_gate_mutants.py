"""Mutating any single check of the motion gate makes a probe fail: every mutant is tried, survivors are named."""

import inspect
import sys
from pathlib import Path
from typing import Any

from gate_mutants import Mutation

from protocol import gate as the_gate

sys.path.append(str(Path(__file__).parents[1] / "unit" / "protocol"))

from test_protocol_gate_sweeps import PROBES, Probe, holds

EQUIVALENT = {
    "check_trajectory: len(knots) < 2: operand 0 scaled": "a count: 1.02 n < 2 is n < 2 for whole n",
    "_trajectory_field_refusals: 1 <= count <= KNOTS_PER_COMMAND: operand 2 scaled": "a count: n <= 6.12 is n <= 6",
    "_trajectory_field_refusals: KNOTS_PER_COMMAND: scaled by 1.02": "the same",
    "_motion_field_refusals: command.traj_id < 1: operand 0 scaled": "a whole number from 0 on: 1.02 n < 1 is n < 1",
    "_stale_state_refusals: 0 <= view.state_age_ns <= STATE_LATE_TIMEOUT.duration_ns: operand 0 scaled": (
        "0 times 1.02 is 0"
    ),
    "_motion_field_refusals: 0.0 <= command.speed_override <= 1.0: operand 0 scaled": "0 times 1.02 is 0",
    "_one_knot: q < axis.q_min: boundary 0 shifted": "asked only where q is outside, so never at q_min",
    "_knot_step_refusals: dt_ns < table.spacing_min_ns: boundary 0 shifted": "asked only where dt is outside",
}


def killers_first(probes: tuple[Probe, ...]) -> list[Probe]:
    """Probes of all kinds early, so that most mutants fall to one of the first."""
    return [probe for first in range(16) for probe in probes[first::16]]


def is_killed(module: Any, probes: list[Probe]) -> bool:
    for probe in probes:
        try:
            if not holds(probe, module):
                return True
        except Exception:  # the mutant no longer works: that is noticed, however it shows
            return True
    return False


def test_every_mutant_of_the_gate_is_killed() -> None:
    mutation = Mutation(inspect.getsource(the_gate))
    probes = killers_first(PROBES)
    survivors = {m.key: m.line for m in mutation.mutants if not is_killed(mutation.module(m), probes)}
    made, killed = len(mutation.mutants), len(mutation.mutants) - len(survivors)
    print(f"\nmotion gate: {killed} killed of {made} mutants; {len(survivors)} equivalent, named with their reasons")
    assert {key: line for key, line in survivors.items() if key not in EQUIVALENT} == {}
    assert set(EQUIVALENT) <= set(survivors), "named as equivalent, but killed or gone"
    assert made >= 600


def test_the_gate_itself_survives_its_own_mutation_unchanged() -> None:
    """Building mutants leaves the tree as it was: the last module built without a change answers every probe."""
    mutation = Mutation(inspect.getsource(the_gate))
    for mutant in mutation.mutants[::20]:
        mutation.module(mutant)
    first = mutation.mutants[0]
    unchanged = mutation.module(type(first)(first.key, first.line, first.node, lambda node: node))
    assert [probe.name for probe in PROBES if not holds(probe, unchanged)] == []
