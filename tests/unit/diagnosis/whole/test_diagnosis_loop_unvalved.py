"""Joints whose valve commands nobody logged are run as loops from the reference on: rows that are rarer than cycles and
a model that is stepped otherwise make no fault of it, and a fault keeps its name and size.
"""

from pathlib import Path

import pytest
from diagnosis_cases import likely
from foreign_plant import Fault, rewritten, write

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import read_for_diagnosis

KINDS = ("steps", "workcycle", "sweep")
MEANT = {"valve_lag": "time_constant_s", "valve_deadband": "half_width_frac"}


@pytest.mark.parametrize(
    ("fault", "name", "size"),
    [
        (Fault(), "", 0.0),
        (Fault(lag_s=(0.025, 0.0)), "valve_lag", 0.025),
        pytest.param(Fault(deadband=(0.02, 0.0)), "valve_deadband", 0.02, marks=pytest.mark.slow),
    ],
)
def test_a_loop_is_judged_by_its_reference(tmp_path: Path, fault: Fault, name: str, size: float) -> None:
    place = write(tmp_path / "run", fault, seed=26, seconds=10.0, kinds=KINDS, log_s=0.005)
    found = answer_json(budget_of(read_for_diagnosis(rewritten(place, without=("u_",)))))
    first = likely(found)
    assert [(one["name"], one["joint"]) for one in first] == ([(name, 1)] if name else []), found["why"]
    assert found["verdict"] == ("effects" if name else "undecided"), found["why"]
    for one in first:
        told = one["parameters"][MEANT[name]]
        assert told["value"] == pytest.approx(size, rel=0.05)
